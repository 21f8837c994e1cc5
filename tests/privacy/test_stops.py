"""Ctrl-C and SIGTERM at random instants of the verbs that search images in several processes."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.privacy.run import deidentify
from tests.interruptions import MIRROR, finish, stop_thrice
from tests.privacy.conftest import make_dataset, options

FRAMES = 12
SEARCH = ("--detector", "faces", "--detector", "plates", "--workers", "2")


@pytest.fixture(autouse=True)
def detectors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes find the installed detectors of marks too."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([*sys.path, os.environ.get("PYTHONPATH", "")]))


def layers(root: Path) -> dict[str, bytes]:
    files = [path for path in root.glob("traversals/*/layers/**/*") if path.is_file()]
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in files}


def test_deidentify_stops_and_continues(tmp_path: Path) -> None:
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    for root in (whole, stopped):
        make_dataset(root, frames=FRAMES)
    words = [*MIRROR, "deidentify", "--plate-region", "XX", *SEARCH]
    whole_s = finish([*words, whole])
    stop_thrice([*words, stopped], 0.6 * whole_s, seed=5)
    finish([*words, stopped])
    assert layers(stopped) == layers(whole) and layers(whole)
    assert not (stopped / ".deidentify").exists()


def test_a_check_of_a_release_stops(tmp_path: Path) -> None:
    dataset, release = str(tmp_path / "dataset"), str(tmp_path / "release")
    make_dataset(tmp_path / "dataset", frames=FRAMES)
    assert deidentify(dataset, options()).exit_code() == 0
    build = ["--name", "marks", "--licence", "CC0-1.0", "--contact", "a@example.org", "--sample", "0"]
    assert main(["release", "build", dataset, *build, "--out", release]) == 0
    words = [*MIRROR, "release", "check", release, *SEARCH]
    stop_thrice(words, 0.6 * finish(words), seed=6)
