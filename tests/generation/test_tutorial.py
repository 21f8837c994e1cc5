"""The tutorial of a generator on one's own street, over the exact background of the tiny street."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from mirror.dataset.dataset import Dataset
from tests.tutorial_pages import follow


def test_a_street_gets_a_generator(
    tiny_dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def copy_street() -> None:
        shutil.copytree(tiny_dataset.root, "street")

    def leave_out() -> None:
        """Leave out a command that other tests run: with a model of the street, the whole page takes 45 s of CPU."""

    street = ["--split", "novel", "--size", "48x32"]
    cameras = ["--cameras", "front_wide,front_left"]
    follow(
        "tutorials/generator.md",
        shorter={
            "generate clips": {"model": ["exact:tiny"], "": ["--min-busy", "0", "--min-move", "0", *street, *cameras]},
            "generate train": {"400": ["2"], "": ["--autoencoder-steps", "2", "--batch", "1", "--threads", "1"]},
            "generate scene": {"model": ["exact:tiny"], "": ["--steps", "1"]},
        },
        stand_ins={
            "synth": leave_out, "ingest": copy_street, "split": leave_out, "reconstruct": leave_out,
            "simulate": leave_out, "evaluate": leave_out,
        },
        capsys=capsys,
    )  # fmt: skip
    assert (tmp_path / "clips" / "sheet.png").is_file()
    assert (tmp_path / "generated" / "generated.json").is_file()
