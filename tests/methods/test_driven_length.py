"""The length of the road of a reconstruction: that of the longest driven line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.dataset.index.build import build_index
from mirror.methods.hosting import driven_length_m
from mirror.schema.files import read_table
from mirror.schema.tables import EGO_POSES
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass


def test_the_longest_line_counts_and_nothing_is_no_line(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    build_index(tmp_path)
    assert driven_length_m(mirror.open(tmp_path)) == 0.0
    lengths = []
    for number, speed_mps in enumerate((3.0, 12.0, 5.0)):
        (name,) = builder.drive(f"d{number}", [Pass("a", EPOCH + number * 60 * SECOND, speed_mps=speed_mps)])
        poses = read_table(builder.layout.recorded(name) / "ego_poses.parquet", EGO_POSES).to_pylist()
        ends = [np.array([row["tx_m"], row["ty_m"], row["tz_m"]]) for row in (poses[0], poses[-1])]
        # The line is straight.
        lengths.append(float(np.linalg.norm(ends[1] - ends[0])))
    build_index(tmp_path)
    assert driven_length_m(mirror.open(tmp_path)) == pytest.approx(max(lengths), abs=1e-9)
    slow = mirror.open(tmp_path).where(drive="d0")
    assert driven_length_m(slow) == pytest.approx(lengths[0], abs=1e-9)
