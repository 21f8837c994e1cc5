"""Units: groups that must stay together in one role, and their order for a seed."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence


def seeded_rank(seed: int, name: str) -> bytes:
    """Return the sort key of a name for a seed, independent of other names."""
    return hashlib.blake2b(name.encode(), key=str(seed).encode(), digest_size=16).digest()


def connected_components(members: Iterable[str], ties: Iterable[Sequence[str]]) -> dict[str, str]:
    """Find the connected components of a graph.

    Args:
        members: the nodes.
        ties: groups of nodes that belong together; nodes outside ``members`` are ignored.

    Returns:
        The name of each member's component, which is its smallest member.
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
    """Return the sorted members of each component, by the component's name.

    Args:
        names: name of each member's component, by member.
    """
    groups = defaultdict(list)
    for member, name in names.items():
        groups[name].append(member)
    return {name: tuple(sorted(members)) for name, members in sorted(groups.items())}
