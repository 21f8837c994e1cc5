"""Suites of drives that are killed at many points and repeated: the same bytes as without an interruption.

``python -m benchmarks suite_kills [--kills N] [--suite NAME|FILE.toml] [--policy P]``. A suite is driven once without
an interruption. Then it is driven again into another folder, killed (SIGKILL, with its workers) as soon as the folder
has a certain number of files, and the command is repeated, until the last one ends by itself. The points are spread
evenly over all files. The error is the number of files that differ, the bar is none.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmarks.report import Row, report

_LOOK_S: Final = 0.002
_POLICY: Final = "constant-velocity"


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns 1 if a file differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks suite_kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=40, help="number of points (default: 40)")
    parser.add_argument("--suite", default="closed-loop-mini", metavar="NAME|FILE.toml")
    parser.add_argument("--policy", default=_POLICY)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args(argv)
    words = ["--suite", arguments.suite, "--policy", arguments.policy, "--workers", str(arguments.workers)]
    with tempfile.TemporaryDirectory(prefix="mirror-kills-") as folder:
        whole, killed = Path(folder) / "whole", Path(folder) / "killed"
        begin = time.perf_counter()
        _start(words, whole).wait()
        whole_ms = 1e3 * (time.perf_counter() - begin)
        expected = read_files(whole)
        begin = time.perf_counter()
        kills = drive_with_kills(words, killed, spread_points(len(expected), arguments.kills))
        ms = 1e3 * (time.perf_counter() - begin)
        found = read_files(killed)
    different = sum(expected.get(name) != found.get(name) for name in expected.keys() | found.keys())
    rows = [
        Row("without an interruption", f"{len(expected)} files", whole_ms, 0.0, unit="files"),
        Row(f"killed {kills} times", f"{len(found)} files", ms, different, unit="files", error_bar=0.5),
    ]
    return report("suite_kills", {"files that differ": rows}, errors="files that differ")


def spread_points(files: int, kills: int) -> list[int]:
    """Spread the numbers of files at which a run is killed, ascending."""
    return [round(files * (kill + 0.5) / kills) for kill in range(kills)]


def drive_with_kills(words: Sequence[str], out: Path, points: Sequence[int]) -> int:
    """Drive a suite, killed each time when its folder has so many files; return how often it was killed."""
    kills = 0
    for point in points:
        process = _start(words, out)
        while process.poll() is None and count_files(out) < point:
            time.sleep(_LOOK_S)
        if process.poll() is None:
            # The command and its workers are one group.
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            kills += 1
    _start(words, out).wait()
    return kills


def count_files(folder: Path) -> int:
    """Count the files of a folder, at any depth."""
    return sum(len(files) for _, _, files in os.walk(folder))


def read_files(folder: Path) -> dict[str, bytes]:
    """Read all files of a folder, by path."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _start(words: Sequence[str], out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "mirror", "simulate", *words, "--out", str(out), "--json"]
    return subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
