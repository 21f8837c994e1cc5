"""Ctrl-C and SIGTERM at several instants of the verbs that search images in several processes."""

from __future__ import annotations

import os
import sys
from functools import partial
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.privacy.run import deidentify
from tests.interruption import SIGNALS, finish, interrupt
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
    words = ["deidentify", "--plate-region", "XX", *SEARCH]
    assert main([*words, "--workers", "1", str(whole)]) == 0
    hits = 0
    # While the workers start, after the first images, and after a part of them.
    for lines, (number, group) in zip((0, 1, 10), SIGNALS):
        ended = interrupt([*words, stopped], 0.0, number, group=group, once=partial(are_searched, stopped, lines))
        hits += ended.hit
        if ended.hit:
            ended.require_stopped()
    assert hits
    finish([*words, stopped])
    assert layers(stopped) == layers(whole) and layers(whole)
    assert not (stopped / ".deidentify").exists()


def are_searched(root: Path, images: int) -> bool:
    return sum(path.read_bytes().count(b"\n") for path in root.glob(".deidentify/**/*.jsonl")) >= images


def test_a_check_of_a_release_stops(tmp_path: Path) -> None:
    dataset, release = str(tmp_path / "dataset"), str(tmp_path / "release")
    make_dataset(tmp_path / "dataset", frames=FRAMES)
    assert deidentify(dataset, options()).exit_code() == 0
    build = ["--name", "marks", "--licence", "CC0-1.0", "--contact", "a@example.org", "--sample", "0"]
    assert main(["release", "build", dataset, *build, "--out", release]) == 0
    hits = 0
    for after_s, (number, group) in zip((0.0, 0.3, 0.6), SIGNALS):
        ended = interrupt(["release", "check", release, *SEARCH], after_s, number, group=group)
        hits += ended.hit
        if ended.hit:
            ended.require_stopped()
    assert hits
