"""Lines of a map: borders of the drivable area and of lanes, and crossings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from mirror.arrays import Float64

LineKind: TypeAlias = Literal["drivable", "lane", "crossing"]
LINE_KINDS: Final[tuple[LineKind, ...]] = get_args(LineKind)

FARTHEST_M: Final = 65.0
"""Lines are drawn up to this distance from the vehicle, as those that OpenDWM's weights were trained with."""
_MARGIN_M: Final = 2.0
"""On a slope the vehicle measures distances along its own floor, where they are a little shorter than on the map."""


@dataclass(frozen=True, eq=False)
class MapLine:
    """One line of a map.

    A segment is drawn where one of its ends is within `FARTHEST_M` of the vehicle: points stand a few metres apart.

    Attributes:
        kind: border of the drivable area, border of a lane, or crossing.
        points_m: (P, 3) points, P at least 2; the first is repeated at the end of a closed line.
    """

    kind: LineKind
    points_m: Float64


def move_lines(lines: Sequence[MapLine], dst_SE3_src: Float64) -> tuple[MapLine, ...]:
    """Return the lines in another frame, given the frame's pose (4, 4)."""
    turn, shift = dst_SE3_src[:3, :3], dst_SE3_src[:3, 3]
    return tuple(replace(line, points_m=line.points_m @ turn.T + shift) for line in lines)


def crop_lines(lines: Sequence[MapLine], places_m: Float64) -> tuple[MapLine, ...]:
    """Return the parts of map lines near some places of the vehicle, where they are drawn.

    Args:
        lines: lines.
        places_m: (F, 3) places of the vehicle, in the frame of the lines.

    Returns:
        All segments with an end near a place on the ground plane, joined to lines.
    """
    return tuple(part for line in lines for part in _near_parts(line, places_m))


def _near_parts(line: MapLine, places_m: Float64) -> Iterator[MapLine]:
    away = np.linalg.norm(line.points_m[:, None, :2] - places_m[None, :, :2], axis=-1)
    near = away.min(axis=1, initial=np.inf) <= FARTHEST_M + _MARGIN_M
    kept = np.concatenate([[False], near[:-1] | near[1:], [False]])
    begins, ends = np.flatnonzero(~kept[:-1] & kept[1:]), np.flatnonzero(kept[:-1] & ~kept[1:])
    for begin, end in zip(begins, ends):
        yield replace(line, points_m=line.points_m[begin : end + 1])
