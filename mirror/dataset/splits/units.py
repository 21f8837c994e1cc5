"""Units: what must stay together in one role, and the order in which a seed takes them."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence


def seeded_rank(seed: int, name: str) -> bytes:
    """Where a seed puts a name among others: the same whatever the others are."""
    return hashlib.blake2b(name.encode(), key=str(seed).encode(), digest_size=16).digest()


def connected_components(members: Iterable[str], ties: Iterable[Sequence[str]]) -> dict[str, str]:
    """Connected components.

    Args:
        members: all of them.
        ties: members that belong together; those that are not in ``members`` are passed over.

    Returns:
        The name of each member's component: its smallest member.
    """
    parent = {member: member for member in members}

    def root(member: str) -> str:
        while parent[member] != member:
            parent[member] = parent[parent[member]]
            member = parent[member]
        return member

    for tie in ties:
        known = [root(member) for member in tie if member in parent]
        for other in known:
            low, high = sorted((root(known[0]), root(other)))
            parent[high] = low
    return {member: root(member) for member in parent}


def members_by_component(names: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """The members of each component, sorted, by its name."""
    groups = defaultdict(list)
    for member, name in names.items():
        groups[name].append(member)
    return {name: tuple(sorted(own)) for name, own in sorted(groups.items())}
