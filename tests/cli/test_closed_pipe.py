"""Where nobody reads its output, a command ends quietly."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

COMMANDS = [
    ["mirror.cli.main", "--help"],
    ["mirror.cli.main", "check", "--help"],
    ["mirror.cli.main", "submission", "check", "--help"],
    ["mirror.cli.main", "nonsense"],
    ["mirror.cli.main", "leaderboard"],
    ["mirror.cli.main", "leaderboard", "build", "--help"],
    ["mirror.cli.main", "baseline", "--help"],
    ["mirror.cli.main", "depth", "--help"],
]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_closed_pipe(words: list[str], unbuffered: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    begun = subprocess.run(
        [sys.executable, "-m", *words],
        stdout=writer,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        check=False,
    )
    os.close(writer)
    expected = b"mirror: no verb" if "nonsense" in words else b""
    assert begun.stderr.startswith(expected) and bool(begun.stderr) == bool(expected), begun.stderr
    # Unbuffered, the first line fails: there was more to say.
    assert begun.returncode in ((0, 2) if not unbuffered else (0, 2, 141))


def test_both_outputs_closed() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    run = subprocess.run(
        [sys.executable, "-m", "mirror.cli.main", "nonsense"], stdout=writer, stderr=writer, check=False
    )
    os.close(writer)
    assert run.returncode in (2, 141)


def test_output_that_cannot_be_written_is_an_error() -> None:
    with open("/dev/full", "wb") as full:  # noqa: PTH123
        run = subprocess.run(
            [sys.executable, "-m", "mirror.cli.main", "--help"],
            stdout=full,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONUNBUFFERED": ""},
            check=False,
        )
    assert run.returncode == 2
    assert run.stderr.startswith(b"mirror: standard output cannot be written: ")
    assert run.stderr.count(b"\n") == 1
