"""The benchmark of real streets: its intervals, its report, and sequences that are not there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.real import SEQUENCES, main, paired_interval, report_rows


def test_intervals_are_those_of_the_clusters_and_not_of_the_images() -> None:
    """Two clusters of many equal images say as much as two images."""
    clusters = np.repeat([0.0, 1.0], 100)
    mean, low, high = paired_interval(np.where(clusters == 0, -1.0, 1.0), clusters)
    assert mean == 0.0 and (low, high) == (-1.0, 1.0)
    single = paired_interval(np.random.default_rng(0).normal(0.5, 1.0, 400), np.arange(400.0))
    assert single[1] < 0.5 < single[2] and single[2] - single[1] == pytest.approx(4 * 1.0 / 20, rel=0.1)


def test_sequences_that_are_not_there_are_skipped_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert all(f"{one.name}: skipped" in said for one in SEQUENCES)


def test_finished_rows_are_read_and_paired(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        {"sequence": name, "method": method, "minutes": 2.0, "psnr": 20.0 + gain, "ssim": 0.8, "seconds": 130.0,
         "bytes": 3_000_000, "images": {"psnr": [19.0 + gain, 21.0 + gain]}}
        for name in ("kitti_odometry_a", "opensfm_lund")
        for method, gain in (("hybridworldsim", 0.5), ("vanilla_3dgs", 0.0))
    ]  # fmt: skip
    (tmp_path / "rows.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert main(["--data", str(tmp_path), "--out", str(tmp_path), "--rows"]) == 0
    said = capsys.readouterr().out
    assert said.splitlines() == list(report_rows(rows))
    assert "pooled over 2 sequences: +0.50 dB (+0.50 to +0.50)" in said
    assert "| kitti_odometry_a | 2 | hybridworldsim | 20.50 | 0.800 | no weights | 130 | 3.0 |" in said
