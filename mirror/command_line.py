"""A verb's arguments from its words: a frozen dataclass, whose docstrings are the help.

A field of type `Path` is a path on this machine; a URL given for it is refused here, for every verb. A field that also
takes a URL is of type `str`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, TypeVar

import tyro

from mirror.errors import UsageError

_Arguments = TypeVar("_Arguments")

# `Path` makes one slash of two, and a scheme is longer than the letter of a drive.
_URL: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/|.*::")


def parsed(kind: type[_Arguments], words: Sequence[str], command: str) -> _Arguments:
    """Arguments of a command; it says what is wrong, or helps, and exits, where there are none to return.

    Args:
        kind: a dataclass.
        words: after the command.
        command: as it is typed.

    Raises:
        UsageError: a URL stands where a path is expected.
    """
    return _local(tyro.cli(kind, args=list(words), prog=command, config=(tyro.conf.PositionalMetavarFromFieldName,)))


def parsed_of(kinds: Mapping[str, Callable[..., _Arguments]], words: Sequence[str], command: str) -> _Arguments:
    """As `parsed`, for a command that has commands of its own, by name."""
    return _local(tyro.extras.subcommand_cli_from_dict(dict(kinds), args=list(words), prog=command))


def local_path(path: Path, place: str | None = None) -> Path:
    """A path from the command line, as it is.

    Args:
        path: of a file or folder, whether or not it exists.
        place: the option that it was given with.

    Raises:
        UsageError: it is a URL: `Path` would take ``s3://bucket`` for a folder ``s3:``.
    """
    if _URL.match(str(path)):
        raise UsageError(
            "this verb takes a path, not a URL",
            file=re.sub(r":/(?!/)", "://", str(path), count=1),
            place=place,
            expected="a path on this machine: remote storage is not supported here yet",
            remedy="copy what is there to this machine first, or copy what is written here to the bucket afterwards;"
            " `mirror stats` and `mirror report` read datasets by URL",
        )
    return path


def _local(arguments: _Arguments) -> _Arguments:
    for value in vars(arguments).values():
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, Path):
                local_path(one)
    return arguments
