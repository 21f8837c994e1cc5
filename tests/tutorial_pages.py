"""Follows a tutorial: runs its blocks of commands and of Python one after the other, at a small size."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from mirror.cli.main import main
from tests.conftest import ROOT

StandIn = Callable[[], None]


def read_blocks(page: str, parts: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Return language and text of the blocks of a page in docs that a reader runs: sh and python.

    Args:
        page: its name below docs.
        parts: headings of the sections whose blocks are returned; none: all sections.
    """
    sections = re.split(r"^## (.*)\n", (ROOT / "docs" / page).read_text(), flags=re.M)
    chosen = [text for heading, text in zip(["", *sections[1::2]], sections[::2]) if not parts or heading in parts]
    assert len(chosen) == len(parts) or not parts, "the page has other headings"
    return re.findall(r"^```(sh|python)\n(.*?)^```", "".join(chosen), re.M | re.S)


def read_commands(block: str) -> list[list[str]]:
    """Return the words of each command of a block, without comments; a backslash continues a line."""
    lines = block.replace("\\\n", " ").splitlines()
    return [words for words in (shlex.split(line, comments=True) for line in lines) if words]


def follow(
    page: str,
    *,
    shorter: Mapping[str, Mapping[str, Sequence[str]]],
    stand_ins: Mapping[str, StandIn],
    capsys: pytest.CaptureFixture[str],
    parts: Sequence[str] = (),
    apart: Sequence[str] = (),
) -> dict[str, str]:
    """Run all blocks of a page in the current folder.

    A block of Python whose first line is a comment with the name of a file is written to that file; others run in one
    namespace. Each command must end with code 0.

    Args:
        page: its name below docs.
        shorter: for a command that begins so, words in place of one of its words, or after all ("").
        stand_ins: functions in place of commands that begin so.
        capsys: reads what commands print.
        parts: headings of the sections to follow; none: all.
        apart: commands with one of these words run in a process of their own.

    Returns:
        What each command printed.
    """
    names: dict[str, Any] = {}
    printed: dict[str, str] = {}
    used: set[str] = set()
    for language, text in read_blocks(page, parts):
        if language == "python":
            file = re.match(r"# (\w+\.py)\n", text)
            if file:
                Path(file[1]).write_text(text)
            else:
                exec(compile(text, page, "exec"), names)
            continue
        for words in read_commands(text):
            line = " ".join(words)
            if words[:1] == ["python"]:
                run_example(words[1:])
                continue
            assert words[0] == "mirror", words
            begun = [begin for begin in (*stand_ins, *shorter) if line.startswith(f"mirror {begin}")]
            used.update(begun)
            capsys.readouterr()
            if begun and begun[0] in stand_ins:
                stand_ins[begun[0]]()
                continue
            given, written = words[1:], None
            if ">" in given:
                given, written = given[: given.index(">")], given[-1]
            for begin in begun:
                for word, others in shorter[begin].items():
                    at = given.index(word) if word else len(given)
                    given[at : at + bool(word)] = others
            if not set(apart).isdisjoint(given):
                printed[line] = run_apart(given)
            else:
                assert main(given) == 0, (given, capsys.readouterr())
                printed[line] = capsys.readouterr().out
            if written is not None:
                Path(written).write_text(printed[line])
    assert used == {*stand_ins, *shorter}, "a command is shortened that the page does not have"
    return printed


def run_example(words: Sequence[str]) -> None:
    """Run a file of examples with words of its command line, in this process."""
    assert words[0].startswith("examples/"), words
    before = sys.argv
    sys.argv = list(words)
    try:
        runpy.run_path(str(ROOT / words[0]), run_name="__main__")
    finally:
        sys.argv = before


def run_apart(words: Sequence[str]) -> str:
    """Run a command of mirror in a process of its own, and return what it printed."""
    done = subprocess.run([sys.executable, "-m", "mirror", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, (words, done.stderr)
    return done.stdout
