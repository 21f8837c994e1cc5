"""Edits of a street's traffic: road users that stand aside of where they were, or that are not there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mirror.errors import DatasetError
from mirror.synth.road_users.body import RoadUser
from mirror.traffic.placement.motion import Motion, Placement, StaticMotion

Shifts = Mapping[str, float | None]
"""Shift of road users to their own left, in metres, by track id; None: the road user is removed."""


@dataclass(frozen=True, eq=False)
class ShiftedMotion:
    """A motion that keeps a constant sideways distance from another motion.

    Attributes:
        motion: the original motion.
        left_m: shift along the body's y axis, in metres; positive is to the left.
    """

    motion: Motion
    left_m: float

    def at(self, time_s: float) -> Placement:
        """Return the shifted placement ``time_s`` seconds after the drive's start."""
        return shift_placement(self.motion.at(time_s), self.left_m)


def shift_placement(placement: Placement, left_m: float) -> Placement:
    """Shift a placement along the body's y axis, in metres; nothing else changes."""
    x_m, y_m, z_m = (placement.translation + left_m * placement.rotation[:, 1]).tolist()
    return replace(placement, x_m=x_m, y_m=y_m, z_m=z_m)


def edit_road_users(road_users: Sequence[RoadUser], shifts: Shifts) -> tuple[RoadUser, ...]:
    """Shift or remove road users; all others stay unchanged and in order.

    Args:
        road_users: all road users.
        shifts: the edits.

    Raises:
        DatasetError: no road user has a track id of the edits.
    """
    unknown = sorted(set(shifts) - {user.track_id for user in road_users})
    if unknown:
        raise DatasetError(
            f"the street has no road user {unknown[0]}",
            place="track_id of an edited box",
            expected="boxes that `mirror synth` wrote with the recordings",
        )
    edited = []
    for user in road_users:
        left_m = shifts.get(user.track_id, 0.0)
        if left_m is not None:
            edited.append(user if user.track_id not in shifts else replace(user, motion=_shift(user.motion, left_m)))
    return tuple(edited)


def _shift(motion: Motion, left_m: float) -> Motion:
    # A parked vehicle stays one: a scene treats the lights and the shadow of moving ones differently.
    if isinstance(motion, StaticMotion):
        return StaticMotion(shift_placement(motion.placement, left_m))
    return ShiftedMotion(motion, left_m)
