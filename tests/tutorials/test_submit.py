"""The tutorial of a participant, with two cameras of the tiny street: from the published dataset to the comparison."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from tests.builders.lanes import add_initial_points
from tests.tutorial_pages import follow

pytest.importorskip("torch")


def test_a_submission_is_trained_on_a_published_dataset_and_compared_with_the_floor(
    tiny_dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def fetch_two_cameras() -> None:
        cameras = ["--camera", "front_wide", "--camera", "rear"]
        assert main(["dataset", "fetch", str(tiny_dataset.root), *cameras, "--out", "full"]) == 0

    def fetch_and_add_points() -> None:
        """Points on either side of the street, in place of those that stereo finds at full size."""
        assert main(["dataset", "fetch", "published", "--out", "street"]) == 0
        add_initial_points(mirror.open("street"))

    one = {"": ["--workers", "1"]}
    printed = follow(
        "tutorials/submit.md",
        shorter={
            "split full": {"": ["--train", "1", "--held-out-traversals", "1"]},
            "dataset publish": {"": ["--licence", "CC0-1.0"]},
            "reconstruct": {
                "--minutes": ["--steps"],
                "1.5": ["3"],
                "160": ["48", "--threads", "1"],
                "plane-sweep": ["made@1"],
            },
            "evaluate": one,
        },
        stand_ins={"synth": lambda: None, "ingest": fetch_two_cameras, "dataset fetch": fetch_and_add_points},
        capsys=capsys,
    )
    street = mirror.open("street")
    training = street.where(split="novel", role="train")
    withheld = training.where(withheld=True).count("images")
    assert 0 < withheld < training.count("images")
    # What the dataset withholds was not trained on, without an option that says so.
    documents = [json.loads(file.read_text()) for file in (tmp_path / "model").glob("*.json")]
    (document,) = [one for one in documents if "withheld" in one]
    assert document["withheld"] == withheld
    (rendered,) = [text for line, text in printed.items() if line.startswith("mirror render")]
    assert "next: mirror submission check street mine" in rendered
    (compared,) = [text for line, text in printed.items() if line.startswith("mirror compare")]
    assert "matched_structure" in compared
    assert (tmp_path / "mine-scores" / "report.html").is_file()
    # What the page's program wrote is a submission too.
    assert main(["evaluate", "full", "other", "--out", "other-scores", "--workers", "1"]) == 0
