"""A verb's arguments from its words: a frozen dataclass, whose docstrings are the help."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import tyro

_Arguments = TypeVar("_Arguments")


def parsed(kind: type[_Arguments], words: Sequence[str], command: str) -> _Arguments:
    """Arguments of a command; it says what is wrong, or helps, and exits, where there are none to return.

    Args:
        kind: a dataclass.
        words: after the command.
        command: as it is typed.
    """
    return tyro.cli(kind, args=list(words), prog=command, config=(tyro.conf.PositionalMetavarFromFieldName,))
