"""A split by traversal: each scene has training and held-out traversals, and all passes of a drive share a role."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Final, TypeAlias

from mirror.counting import count_of
from mirror.dataset.splits.assignment import Assignment, describe_tie
from mirror.dataset.splits.candidates import Candidate
from mirror.dataset.splits.leaks import Tie
from mirror.dataset.splits.units import connected_components, seeded_rank
from mirror.errors import DatasetError
from mirror.schema.documents import NovelTraversal, Role

_TRIALS: Final = 200_000
_Passes: TypeAlias = dict[str, list[str]]
"""Traversal ids by unit."""


def assign(traversals: Sequence[Candidate], ties: Sequence[Tie], parameters: NovelTraversal, seed: int) -> Assignment:
    """Choose the held-out traversals by seed.

    Tied traversals form a unit, above all the passes of one drive. Units are held out in the order of a keyed hash,
    until every scene has its held-out traversals and enough others to train on. If that order leads to a dead end,
    the search goes back and tries the next unit, so it fails only if no choice exists.

    Args:
        traversals: the traversals to assign.
        ties: ties between traversals.
        parameters: number of traversals for each role in a scene.
        seed: seed of the order.

    Raises:
        DatasetError: no choice exists; the error names the scene and two traversals that prevent it.
    """
    unit_of = connected_components((item.traversal_id for item in traversals), (tie.members for tie in ties))
    order = {unit: seeded_rank(seed, unit) for unit in unit_of.values()}
    scenes: dict[str, _Passes] = defaultdict(lambda: defaultdict(list))
    with_images = {item.scene_id for item in traversals if item.has_images}
    for item in sorted(traversals, key=lambda item: (item.scene_id, item.traversal_id)):
        # Traversals without images cannot be trained on or scored. They are used only in scenes without any images.
        if item.scene_id in with_images and not item.has_images:
            continue
        scenes[item.scene_id][unit_of[item.traversal_id]].append(item.traversal_id)
    needed = parameters.train + parameters.held_out
    left_out = {
        scene_id: f"{count_of(count, 'traversal')}, but {parameters.train} to train on and {parameters.held_out}"
        " to hold out needed"
        for scene_id, passes in scenes.items()
        if (count := sum(map(len, passes.values()))) < needed
    }
    enough = {scene_id: passes for scene_id, passes in scenes.items() if scene_id not in left_out}
    # The scenes with the fewest units come first.
    enough = dict(sorted(enough.items(), key=lambda item: (len(item[1]), item[0])))
    held = _hold_out(enough, order, parameters)
    if held is None:
        raise _no_assignment_error(enough, order, parameters, ties)
    roles: dict[str, Role] = {item.traversal_id: "unused" for item in traversals}
    for passes in enough.values():
        out = {unit: own for unit, own in passes.items() if unit in held}
        rest = {unit: own for unit, own in passes.items() if unit not in held}
        roles.update(dict.fromkeys(_fill(out, parameters.held_out, order), "held_out"))
        roles.update(dict.fromkeys(_fill(rest, parameters.train, order), "train"))
    return Assignment(roles, left_out)


def _hold_out(
    scenes: Mapping[str, _Passes], order: Mapping[str, bytes], parameters: NovelTraversal
) -> frozenset[str] | None:
    """Choose the units to hold out, by backtracking; None: no choice exists."""
    totals = {scene_id: sum(map(len, passes.values())) for scene_id, passes in scenes.items()}
    count = dict.fromkeys(scenes, 0)
    passes_of: dict[str, dict[str, int]] = defaultdict(dict)
    for scene_id, passes in scenes.items():
        for unit, own in passes.items():
            passes_of[unit][scene_id] = len(own)
    # Units in the order of decision: True is held out; False may not be held out while the earlier decisions stand.
    decided: dict[str, bool] = {}

    def add_counts(unit: str, sign: int) -> None:
        for scene_id, number in passes_of[unit].items():
            count[scene_id] += sign * number

    def leaves_enough(unit: str) -> bool:
        return all(totals[key] - count[key] - number >= parameters.train for key, number in passes_of[unit].items())

    for _ in range(_TRIALS):
        short = next((scene_id for scene_id in scenes if count[scene_id] < parameters.held_out), None)
        if short is None:
            return frozenset(unit for unit, out in decided.items() if out)
        missing = parameters.held_out - count[short]
        open_units = [unit for unit in scenes[short] if unit not in decided and leaves_enough(unit)]
        if open_units:
            # Of a unit with more passes than are missing, some would remain unused.
            unit = min(open_units, key=lambda unit: (passes_of[unit][short] > missing, order[unit]))
            decided[unit] = True
            add_counts(unit, 1)
            continue
        while decided and not decided[next(reversed(decided))]:
            decided.popitem()
        if not decided:
            return None
        unit, _out = decided.popitem()
        add_counts(unit, -1)
        decided[unit] = False
    raise DatasetError(
        f"no division without a leak was found in {_TRIALS} trials",
        expected="scenes whose drives are not all entangled with each other",
        remedy="divide fewer scenes at once: name them with --scene",
    )


def _fill(passes: _Passes, quota: int, order: Mapping[str, bytes]) -> list[str]:
    """Choose complete units with ``quota`` traversals together; if impossible, part of one unit is left out."""
    units = sorted(passes, key=lambda unit: order[unit])
    # For each possible sum, the first subset of units in that order.
    reached: dict[int, tuple[str, ...]] = {0: ()}
    for unit in units:
        for total, chosen in sorted(reached.items(), reverse=True):
            reached.setdefault(total + len(passes[unit]), (*chosen, unit))
        if quota in reached:
            break
    chosen_units = reached.get(quota, tuple(units))
    return [traversal_id for unit in chosen_units for traversal_id in passes[unit]][:quota]


def _no_assignment_error(
    scenes: Mapping[str, _Passes], order: Mapping[str, bytes], parameters: NovelTraversal, ties: Sequence[Tie]
) -> DatasetError:
    """The error for scenes that cannot be divided. It names the first scene that conflicts with the earlier ones."""
    before: dict[str, _Passes] = {}
    for scene_id, passes in scenes.items():
        if _hold_out({**before, scene_id: passes}, order, parameters) is None:
            break
        before[scene_id] = passes
    elsewhere = {unit: own for item in before.values() for unit, own in item.items()}
    pairs = [(own[0], own[1]) for own in passes.values() if len(own) > 1]
    pairs += [(elsewhere[unit][0], own[0]) for unit, own in passes.items() if unit in elsewhere]
    first, second = pairs[0]
    return DatasetError(
        f"scene {scene_id} cannot be divided without a leak: {first} and {second} {describe_tie(first, second, ties)},"
        f" but one of them would have to be held out and the other trained on",
        expected=f"{parameters.train} traversals to train on and {parameters.held_out} to hold out that share no drive,"
        " no image and no time of one vehicle",
        remedy="leave the scene out by naming the others with --scene, ask for fewer with --train, or record it again",
    )
