"""The result of a split method."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mirror.dataset.splits.leaks import Tie
from mirror.schema.documents import Role


@dataclass(frozen=True)
class Assignment:
    """Roles of the traversals, and the scenes and traversals without a role.

    Attributes:
        roles: role of every traversal, by id.
        left_out: reason why a scene or traversal has no role, by its id.
    """

    roles: Mapping[str, Role]
    left_out: Mapping[str, str]


def describe_tie(first: str, second: str, ties: Iterable[Tie]) -> str:
    """Describe the property that two traversals of one unit share."""
    direct = [tie.reason for tie in ties if first in tie.members and second in tie.members]
    return direct[0] if direct else "are tied to each other through other traversals"
