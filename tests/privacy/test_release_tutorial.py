"""The tutorial of a redacted release, with marks in place of faces and plates."""

from __future__ import annotations

from pathlib import Path

import pytest

import mirror
from tests.privacy.conftest import FACE, make_dataset
from tests.tutorial_pages import follow


def test_a_recording_becomes_a_redacted_release(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def ingest() -> None:
        make_dataset(tmp_path / "dataset")

    follow(
        "tutorials/release.md",
        shorter={
            "deidentify": {"EU": ["XX", "--detector", "faces", "--detector", "plates", "--workers", "1"]},
            "dataset publish": {"": ["--no-masks"]},
        },
        stand_ins={
            "synth": lambda: None,
            "ingest": ingest,
            "weights fetch": lambda: None,
        },
        capsys=capsys,
    )
    images = mirror.open("copy").table("images").to_pylist()
    assert images and {row["privacy"] for row in images} == {"redacted"}
    for frame in mirror.open("release").where(camera="front_wide").frames():
        left, top, right, bottom = FACE
        face = frame.images["front_wide"].decode()[top:bottom, left:right]
        assert face[..., 0].astype(int).max() - face[..., 1].min() < 255, "nothing of the red mark is left"
    assert any((tmp_path / "plots").iterdir())
