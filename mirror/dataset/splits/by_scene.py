"""A split by scene: all traversals of a scene get the same role. Scenes that share ground or a drive stay together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from mirror.dataset.splits.assignment import Assignment, describe_tie
from mirror.dataset.splits.candidates import Candidate
from mirror.dataset.splits.leaks import Tie
from mirror.dataset.splits.units import connected_components, members_by_component, seeded_rank
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import ByScene, Role


def assign(traversals: Sequence[Candidate], ties: Sequence[Tie], parameters: ByScene, seed: int) -> Assignment:
    """Assign scenes to roles by seed.

    Tied scenes form a unit: a drive passes through both, or their circles overlap. Units are assigned by decreasing
    size, and units of equal size in the order of a keyed hash. Each goes to the role that is farthest below its share.

    Args:
        traversals: the traversals to assign.
        ties: ties between traversals, including those of scenes.
        parameters: the shares of the roles.
        seed: seed of the order.

    Raises:
        UsageError: there are fewer scenes than roles.
        DatasetError: a role gets no scene because of ties; the error names two tied traversals.
    """
    scene_of = {item.traversal_id: item.scene_id for item in traversals}
    scenes = sorted(set(scene_of.values()))
    shares: dict[Role, float] = {"train": parameters.train, "val": parameters.val, "test": parameters.test}
    shares = {role: share for role, share in shares.items() if share > 0}
    if len(scenes) < len(shares):
        raise UsageError(
            f"{len(scenes)} scenes with traversals cannot fill the roles {', '.join(shares)}",
            expected="at least a scene for each role",
            remedy="set shares to 0, e.g. --val 0",
        )
    units = members_by_component(
        connected_components(scenes, ([scene_of[key] for key in tie.members if key in scene_of] for tie in ties))
    )
    if len(units) < len(shares):
        raise _no_assignment_error(units, scene_of, ties, shares)
    target = {role: share * len(scenes) for role, share in shares.items()}
    filled: dict[Role, int] = dict.fromkeys(shares, 0)
    role_of: dict[str, Role] = {}
    waiting = sorted(units, key=lambda unit: (-len(units[unit]), seeded_rank(seed, unit)))
    for number, unit in enumerate(waiting):
        empty = [role for role in shares if not filled[role]]
        # The last units go to the roles that are still empty.
        open_roles = empty if len(waiting) - number <= len(empty) else list(shares)
        role = max(open_roles, key=lambda role: target[role] - filled[role])
        filled[role] += len(units[unit])
        role_of.update(dict.fromkeys(units[unit], role))
    return Assignment({key: role_of[scene_id] for key, scene_id in scene_of.items()}, {})


def _no_assignment_error(
    units: Mapping[str, Sequence[str]], scene_of: Mapping[str, str], ties: Sequence[Tie], shares: Mapping[Role, float]
) -> DatasetError:
    by_scene = defaultdict(set)
    for traversal_id, scene_id in scene_of.items():
        by_scene[scene_id].add(traversal_id)
    largest = max(units.values(), key=len)
    for tie in ties:
        members = [key for key in tie.members if scene_of.get(key) in largest]
        other = next((key for key in members if scene_of[key] != scene_of[members[0]]), None)
        if other is not None:
            break
    first, second = members[0], str(other)
    return DatasetError(
        f"{len(scene_of)} traversals of {sum(map(len, units.values()))} scenes cannot fill {len(shares)} roles without"
        f" a leak: {first} and {second} {describe_tie(first, second, [tie])}",
        place=f"scenes {scene_of[first]} and {scene_of[second]}",
        expected=f"scenes in at least {len(shares)} groups that share no drive, no image and no ground",
        remedy="leave scenes out by naming the others with --scene, or set shares to 0, e.g. --val 0",
    )
