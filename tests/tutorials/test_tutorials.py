"""The tutorials lead from their first block to their last, at a small size."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from tests.tutorial_pages import follow


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
    assert (canvas == (102, 209, 255)).all(axis=-1).sum() > 20, "an outline of a box"
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
    assert main(["protocols", "show", "closed-loop-mini"]) == 0
    head, *blocks = re.split(r"^(?=\[)", capsys.readouterr().out, flags=re.M)
    street, start = (
        next(block for block in blocks if block.startswith(f"[[suite.{name}]]")) for name in ("streets", "starts")
    )
    rest = [block for block in blocks if not block.startswith("[[suite.")]
    at = [block.startswith("[suite]") for block in rest].index(True) + 1
    rest[at:at] = [re.sub(r'source = ".*?"', 'source = "synth:tiny:0:guangzhou-urban-01"', street), start]
    small = head + "".join(rest)
    small = small.replace('name = "closed-loop-mini"', 'name = "small"').replace("duration_s = 8.0", "duration_s = 1.0")
    names = small[small.index("scenarios = [") :].partition("\n")[0]
    Path("small.toml").write_text(small.replace(names, 'scenarios = ["cut-in"]'))
    suite = {"closed-loop-mini": ["small.toml"]}
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
