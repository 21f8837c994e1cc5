"""What a method answers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mirror.dataset.splits.leaks import Tie
from mirror.schema.documents import Role


@dataclass(frozen=True)
class Assignment:
    """The role of every traversal by id, and why a scene or a traversal is in none, by its id."""

    roles: Mapping[str, Role]
    left_out: Mapping[str, str]


def describe_tie(first: str, second: str, ties: Iterable[Tie]) -> str:
    """What two traversals of one unit share, in words."""
    direct = [tie.reason for tie in ties if first in tie.members and second in tie.members]
    return direct[0] if direct else "are tied to each other by others in between"
