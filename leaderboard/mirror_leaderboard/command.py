"""``mirror leaderboard``: build, add."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode, UsageError
from mirror_leaderboard.refused import RefusedError

PAPERS: Final = Path(__file__).parent / "papers"
"""The board of figures that papers report."""
BOARD: Final = Path("leaderboard")
"""The default board."""

_BUILD_EXAMPLES = (
    "mirror leaderboard build --board demo/board --out site",
    "mirror leaderboard build --board demo/board --also leaderboard --out site",
)
_ADD_EXAMPLES = (
    "mirror leaderboard add demo/results/mean_color/result.json --dataset-name 'my street' --board board",
    "mirror leaderboard add demo/results/mean_color/result.json demo/dataset --dataset-name 'my street'"
    " --submission demo/submissions/mean_color --board board",
)
_ADD_RENAMED = {"--dataset": "--dataset-name", "--truth": "[DATASET]"}


@dataclass(frozen=True)
class Build:
    """Write the site of the leaderboard as static files. A browser opens its index.html without a server."""

    out: Path = Path("site")
    """Folder for the site."""
    board: Annotated[Path | None, help_text(default="./leaderboard if it is a board", metavar="FOLDER")] = None
    """Board to show beside the figures of papers: a folder that `mirror leaderboard add` wrote."""
    also: Annotated[tuple[Path, ...], help_text(default="none", metavar="FOLDER")] = ()
    """More boards. An entry replaces the same entry of a board before it."""


@dataclass(frozen=True, kw_only=True)
class Add:
    """Add a result to a board, after checks of its hashes, its protocol and its values."""

    result: tyro.conf.Positional[Path]
    """`result.json` of `mirror evaluate`."""
    dataset: Annotated[tyro.conf.Positional[Path | None], help_text(default="none", metavar="[DATASET]")] = None
    """Folder of the dataset, for the images of --submission."""
    dataset_name: Annotated[str, help_text(metavar="NAME")]
    """Name of the dataset on the board."""
    setting: Annotated[str | None, help_text(default="none")] = None
    """Setting that distinguishes this row from others of the same method and version."""
    submission: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Show some renders of this submission beside the truth. Requires DATASET."""
    board: Annotated[Path, help_text(metavar="FOLDER")] = BOARD
    """Folder of the board, created if it does not exist."""


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
    arguments = parse_arguments(Build, argv, "mirror leaderboard build", examples=_BUILD_EXAMPLES)
    from mirror_leaderboard.site.page import build

    has_default = arguments.board is None and (BOARD / "entries").is_dir()
    boards = (BOARD,) if has_default else () if arguments.board is None else (arguments.board,)
    print(f"site: {build((PAPERS, *boards, *arguments.also), arguments.out)}")
    return ExitCode.DONE


def _add(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Add, argv, "mirror leaderboard add", examples=_ADD_EXAMPLES, renamed=_ADD_RENAMED)
    from mirror_leaderboard.add import add_result
    from mirror_leaderboard.images import ImageSources

    if (arguments.submission is None) != (arguments.dataset is None):
        raise UsageError("--submission and DATASET require each other", expected="both, or neither")
    images = None
    if arguments.submission is not None and arguments.dataset is not None:
        images = ImageSources(arguments.submission, arguments.dataset)
    entry = add_result(
        arguments.result, arguments.board, arguments.dataset_name, setting=arguments.setting, images=images
    )
    print(f"entry: {entry}")
    return ExitCode.DONE
