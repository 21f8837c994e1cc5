"""The tutorials lead from their first block to their last, at a small size."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.dataset.dataset import Dataset
from tests.tutorial_pages import follow
from tests.tutorials.small_suite import write_small_suite


@pytest.fixture
def demo(tiny_dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with demo/dataset, the tiny street in place of the demo's."""
    shutil.copytree(tiny_dataset.root, tmp_path / "demo" / "dataset")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_dataset_is_explored(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = follow("tutorials/explore.md", shorter={}, stand_ins={"demo --quick": lambda: None}, capsys=capsys)
    assert (demo / "report.html").stat().st_size > 10_000
    assert any((demo / "plots").iterdir())
    canvas = cv2.imread(str(demo / "boxes.png"))
    assert np.all(canvas == (102, 209, 255), axis=-1).sum() > 20, "an outline of a box"
    (query,) = [text for line, text in printed.items() if line.startswith("mirror sql")]
    assert "day" in query and "metres" in query


def test_a_method_is_scored_beside_the_floor(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    one = {"": ["--workers", "1"]}
    printed = follow("tutorials/method.md", shorter={"evaluate": one}, stand_ins={}, capsys=capsys)
    (compared,) = [text for line, text in printed.items() if line.startswith("mirror compare")]
    assert "matched_structure" in compared
    scores = {}
    for name in ("mine", "floor"):
        figures = json.loads((demo / f"{name}-scores" / "result.json").read_text())["figures"]
        novel = [one for one in figures if (one["group"], one["level"]) == ("novel", "group")]
        scores[name] = {one["metric"]: one["value"] for one in novel}
    # As the page says: the mean wins in PSNR, and neither shows the place.
    assert scores["mine"]["psnr"] > scores["floor"]["psnr"]
    assert max(scores[name]["matched_structure"] for name in scores) < 0.1


def test_a_policy_drives_and_is_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    suite = write_small_suite(capsys)
    printed = follow(
        "tutorials/policy.md",
        shorter={
            "simulate --suite": suite, "evaluate my-drives": suite, "evaluate idm-drives": suite,
            "simulate synth:tiny": {"": ["--duration", "1", "--width", "64"]},
        },
        stand_ins={},
        capsys=capsys,
    )  # fmt: skip
    assert (tmp_path / "drive" / "report.html").is_file() and (tmp_path / "my-scores" / "report.html").is_file()
    (compared,) = [text for line, text in printed.items() if line.startswith("mirror compare")]
    assert "epdms" in compared
