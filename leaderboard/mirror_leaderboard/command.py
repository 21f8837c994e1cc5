"""``mirror leaderboard``: build, add."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import tyro

from mirror.command_line import Subcommand, parse_arguments, run_subcommand
from mirror.errors import ExitCode, UsageError
from mirror_leaderboard.refused import RefusedError

PAPERS: Final = Path(__file__).parent / "papers"
"""The board of what papers report."""
BOARD: Final = Path("leaderboard")
"""Holds ``entries`` and ``pictures``."""


@dataclass(frozen=True)
class Build:
    """Write the static site: open its index.html, no server is needed."""

    out: Path = Path("site")
    """Folder of the site."""
    board: Path | None = None
    """Folder that holds `entries` and `pictures`, to stand beside what papers report. Default: ./leaderboard, where it
    is one."""
    also: tuple[Path, ...] = ()
    """More such folders; their entries stand in for the same ones of those before."""


@dataclass(frozen=True)
class Add:
    """Put a result on the board, after holding it against its hashes, the protocol and what is possible."""

    result: tyro.conf.Positional[Path]
    """`result.json` of `mirror evaluate`."""
    dataset: str
    """What the data set is called on the board."""
    setting: str | None = None
    """What tells this row from others of the same method and version."""
    submission: Path | None = None
    """The submission: some of its renders are shown beside the truth. Needs --truth."""
    truth: Path | None = None
    """The dataset that it was scored against."""
    board: Path = BOARD
    """Folder that holds `entries` and `pictures`; made if it is not there."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "build": Subcommand("write the static site", _build),
        "add": Subcommand("put a result.json on the board", _add),
    }
    try:
        return run_subcommand(argv, "mirror leaderboard", subcommands)
    except RefusedError as error:
        print(f"mirror leaderboard {argv[0]}: refused: {error}", file=sys.stderr)
        return ExitCode.FINDINGS


def _build(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Build, argv, "mirror leaderboard build")
    from mirror_leaderboard.site.page import build

    found = arguments.board is None and (BOARD / "entries").is_dir()
    boards = (BOARD,) if found else () if arguments.board is None else (arguments.board,)
    print(f"site: {build((PAPERS, *boards, *arguments.also), arguments.out)}")
    return ExitCode.DONE


def _add(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Add, argv, "mirror leaderboard add")
    from mirror_leaderboard.add import add_result
    from mirror_leaderboard.images import ImageSources

    if (arguments.submission is None) != (arguments.truth is None):
        raise UsageError("--submission and --truth go together", expected="both, or neither")
    shown = None
    if arguments.submission is not None and arguments.truth is not None:
        shown = ImageSources(arguments.submission, arguments.truth)
    entry = add_result(arguments.result, arguments.board, arguments.dataset, setting=arguments.setting, shown=shown)
    print(f"entry: {entry}")
    return ExitCode.DONE
