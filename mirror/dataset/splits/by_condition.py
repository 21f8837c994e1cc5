"""A split by condition: roles follow the light and weather of the recordings."""

from __future__ import annotations

from collections.abc import Sequence

from mirror.dataset.splits.assignment import Assignment, describe_tie
from mirror.dataset.splits.candidates import Candidate
from mirror.dataset.splits.leaks import Tie
from mirror.dataset.splits.units import connected_components, members_by_component
from mirror.errors import DatasetError
from mirror.schema.documents import ByCondition, LightAndWeather, Role


def assign(traversals: Sequence[Candidate], ties: Sequence[Tie], parameters: ByCondition) -> Assignment:
    """Assign roles by condition: a matching test condition gives the role test, else a matching train condition train.

    If conditions change during a drive (into dusk, out of the rain), its passes that match a test condition are tested
    on, and its other passes get no role.

    Args:
        traversals: the traversals to assign.
        ties: ties between traversals.
        parameters: the conditions.

    Raises:
        DatasetError: a role gets no traversal: none matches, or all matching ones are tied to the other role.
    """
    roles: dict[str, Role] = {item.traversal_id: role_of(item, parameters) for item in traversals}
    matched_roles = set(roles.values())
    left_out: dict[str, str] = {}
    units = members_by_component(connected_components(roles, (tie.members for tie in ties)))
    for members in units.values():
        tested = [key for key in members if roles[key] == "test"]
        for key in members if tested else ():
            if roles[key] == "train":
                roles[key] = "unused"
                left_out[key] = f"{key} and {tested[0]}, which is tested on, {describe_tie(key, tested[0], ties)}"
    for role, conditions in (("train", parameters.train), ("test", parameters.test)):
        if role not in roles.values():
            listed = " or ".join(_text(condition) for condition in conditions)
            reason = next(iter(left_out.values())) if role in matched_roles else f"no traversal has {listed}"
            raise DatasetError(
                f"no traversal is left to {role} on: {reason}",
                expected=f"traversals with {listed} that share no drive, no image and no time of one vehicle with"
                " those of the other role",
                remedy="name other conditions; `mirror stats` lists the conditions of the dataset",
            )
    return Assignment(roles, left_out)


def role_of(item: Candidate, parameters: ByCondition) -> Role:
    """Return the role that follows from a traversal's light and weather."""
    if any(_matches(item, condition) for condition in parameters.test):
        return "test"
    if any(_matches(item, condition) for condition in parameters.train):
        return "train"
    return "unused"


def _matches(item: Candidate, condition: LightAndWeather) -> bool:
    return condition.light in (None, item.light) and condition.weather in (None, item.weather)


def _text(condition: LightAndWeather) -> str:
    return ",".join(f"{name}={value}" for name, value in condition.model_dump(exclude_none=True).items())
