"""Follows a tutorial: runs its blocks of commands and of Python one after the other, at a small size."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from mirror.cli.main import main
from tests.conftest import ROOT

StandIn = Callable[[], None]


def read_blocks(page: str) -> list[tuple[str, str]]:
    """Return language and text of the blocks of a page in docs that a reader runs: sh and python."""
    return re.findall(r"^```(sh|python)\n(.*?)^```", (ROOT / "docs" / page).read_text(), re.M | re.S)


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
) -> dict[str, str]:
    """Run all blocks of a page in the current folder.

    A block of Python whose first line is a comment with the name of a file is written to that file; others run in one
    namespace. Each command must end with code 0.

    Args:
        page: its name below docs.
        shorter: for a command that begins so, words in place of one of its words, or after all ("").
        stand_ins: functions in place of commands that begin so.
        capsys: reads what commands print.

    Returns:
        What each command printed.
    """
    names: dict[str, Any] = {}
    printed: dict[str, str] = {}
    used: set[str] = set()
    for language, text in read_blocks(page):
        if language == "python":
            file = re.match(r"# (\w+\.py)\n", text)
            if file:
                Path(file[1]).write_text(text)
            else:
                exec(compile(text, page, "exec"), names)
            continue
        for words in read_commands(text):
            assert words[0] == "mirror", words
            line = " ".join(words)
            begun = [begin for begin in (*stand_ins, *shorter) if line.startswith(f"mirror {begin}")]
            used.update(begun)
            capsys.readouterr()
            if begun and begun[0] in stand_ins:
                stand_ins[begun[0]]()
                continue
            given = words[1:]
            for begin in begun:
                for word, others in shorter[begin].items():
                    at = given.index(word) if word else len(given)
                    given[at : at + bool(word)] = others
            assert main(given) == 0, (given, capsys.readouterr())
            printed[line] = capsys.readouterr().out
    assert used == {*stand_ins, *shorter}, "a command is shortened that the page does not have"
    return printed
