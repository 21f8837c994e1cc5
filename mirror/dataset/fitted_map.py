"""A road map that is fitted to driven lines, for scenes that have no other map. It is marked as fitted.

A lane is a driven corridor: lines that run beside each other in the same direction are one lane, and its middle is
their mean. Where a line leaves a lane or joins it, the lane is cut, so that lanes have successors. The drivable area is
what lies within half of a lane's width and a margin of any driven line. Nothing is known of where nobody drove:
neighbouring lanes, the edges of the road, crossings and signals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import shapely

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.schema.road_map import MapArea, MapLane, RoadMap

WIDTH_M: Final = 3.25
"""Least width of a fitted lane."""
MARGIN_M: Final = 0.5
"""Reach of the drivable area beyond half of that width from a driven line."""
VEHICLE_WIDTH_M: Final = 1.9
"""Width of the vehicles that drove: a corridor is wider than the spread of its lines by this."""
_STEP_M: Final = 1.0
_SAME_M: Final = 1.75
_SAME_COS: Final = 0.9
_LEAST_M: Final = 10.0
_SMOOTH_M: Final = 7


@dataclass
class _Corridor:
    """A lane that is being fitted.

    Attributes:
        line: (K, 3) its first line.
        offsets: lists of offsets of other lines, by index of the point.
        cuts: indices at which other corridors leave it or join it.
        before: corridor and index that it comes from.
        after: corridor and index that it leads to.
    """

    line: Float64
    offsets: dict[int, list[float]] = field(default_factory=dict)
    cuts: set[int] = field(default_factory=set)
    before: tuple[int, int] | None = None
    after: tuple[int, int] | None = None


def fit_road_map(
    scene_id: str,
    frame: str | None,
    lines: Sequence[Float64],
    *,
    width_m: float = WIDTH_M,
    margin_m: float = MARGIN_M,
) -> RoadMap:
    """Fit a map to driven lines.

    Args:
        scene_id: the scene.
        frame: name of its local metric frame; None: the east-north-up frame at the centre of its ROI.
        lines: lines (N, 3) of the middle of the rear axle in the scene's frame, in the order of time.
        width_m: least width of a lane.
        margin_m: how far the drivable area reaches beyond half of that width from a driven line.

    Raises:
        UsageError: no line is longer than ten metres, a coordinate is not finite, or the width or margin is invalid.
    """
    if not (0.0 < width_m < 20.0 and 0.0 <= margin_m < 20.0):
        raise UsageError(f"a width of {width_m} m and a margin of {margin_m} m", expected="metres, below 20")
    driven = [even for even in map(_resample, lines) if len(even) > _LEAST_M / _STEP_M]
    if not driven:
        raise UsageError(
            "no driven line is longer than 10 m", place=f"scene {scene_id}", expected="a traversal that moves"
        )
    corridors: list[_Corridor] = []
    for line in sorted(driven, key=len, reverse=True):
        _add_line(corridors, line)
    reach = 0.5 * width_m + margin_m
    area = shapely.union_all([shapely.LineString(line[:, :2]).buffer(reach, quad_segs=4) for line in driven])
    lanes = {lane.lane_id: lane for lane in _cut_lanes(corridors, width_m)}
    parts = tuple(
        MapArea(
            f"driven-{number}",
            tuple(shapely.get_coordinates(ring)[:-1] for ring in (part.exterior, *part.interiors)),
        )
        for number, part in enumerate(shapely.get_parts(area))
    )
    return RoadMap(scene_id, frame, True, lanes, parts, margin_m=reach)


def _resample(line: Float64) -> Float64:
    """The line in steps of a metre, without standstills."""
    if line.ndim != 2 or line.shape[1:] != (3,) or not np.isfinite(line).all():
        raise UsageError(f"a driven line of shape {line.shape}", expected="(N, 3) finite coordinates")
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])
    moving = np.concatenate([[True], np.diff(along) > 1e-3])
    even = np.arange(0.0, along[-1], _STEP_M)
    return np.column_stack([np.interp(even, along[moving], line[moving, axis]) for axis in range(3)])


def _add_line(corridors: list[_Corridor], line: Float64) -> None:
    """Add a driven line: where it runs along a corridor it widens that one, elsewhere it begins new ones."""
    owner, index = _assign(corridors, line)
    for number, at, offset in zip(owner.tolist(), index.tolist(), _offsets(corridors, line, owner, index)):
        if number >= 0:
            corridors[number].offsets.setdefault(at, []).append(offset)
    for begin, end in _runs(owner < 0):
        if end - begin < _LEAST_M / _STEP_M:
            continue
        # One point of the neighbours makes the new corridor begin and end on them.
        low, high = max(begin - 1, 0), min(end + 1, len(line))
        corridor = _Corridor(line[low:high])
        if low < begin:
            corridor.before = int(owner[low]), int(index[low])
            corridors[owner[low]].cuts.add(int(index[low]))
        if high > end:
            corridor.after = int(owner[high - 1]), int(index[high - 1])
            corridors[owner[high - 1]].cuts.add(int(index[high - 1]))
        corridors.append(corridor)


def _assign(corridors: Sequence[_Corridor], line: Float64) -> tuple[Int64, Int64]:
    """The corridor (N,) that each point of a line runs along, -1: none, and the nearest point (N,) of that."""
    owner, index = np.full(len(line), -1), np.zeros(len(line), np.int64)
    least = np.full(len(line), _SAME_M)
    course = np.gradient(line[:, :2], axis=0)
    for number, corridor in enumerate(corridors):
        tree = shapely.STRtree(shapely.points(corridor.line[:, :2]))
        nearest = tree.nearest(shapely.points(line[:, :2]))
        away = np.hypot(*(line[:, :2] - corridor.line[nearest, :2]).T)
        own = np.gradient(corridor.line[:, :2], axis=0)[nearest]
        same = (course * own).sum(axis=1) > _SAME_COS * np.linalg.norm(course, axis=1) * np.linalg.norm(own, axis=1)
        better = same & (away < least)
        owner[better], index[better], least[better] = number, nearest[better], away[better]
    return owner, index


def _offsets(corridors: Sequence[_Corridor], line: Float64, owner: Int64, index: Int64) -> Float64:
    """Offsets (N,) of the points to the left of their corridors' first lines."""
    found = np.zeros(len(line))
    for number in set(owner.tolist()) - {-1}:
        rows, base = owner == number, corridors[number].line[:, :2]
        ahead = np.gradient(base, axis=0)[index[rows]]
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        gap = line[rows, :2] - base[index[rows]]
        found[rows] = ahead[:, 0] * gap[:, 1] - ahead[:, 1] * gap[:, 0]
    return found


def _runs(holds: Bool) -> Iterator[tuple[int, int]]:
    """Begins and ends of the runs in which a condition holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist())


def _cut_lanes(corridors: Sequence[_Corridor], width_m: float) -> Iterator[MapLane]:
    """Yield the lanes: the corridors with their mean lines, cut where others leave or join."""
    bounds = [_bounds(corridor) for corridor in corridors]

    def piece(number: int, index: int, *, ends: bool) -> str:
        """The piece of a corridor that ends, or begins, at a cut."""
        cuts = bounds[number]
        nearest = min(range(len(cuts)), key=lambda place: abs(cuts[place] - index))
        part = min(max(nearest - int(ends), 0), len(cuts) - 2)
        return f"driven-{number}.{part}"

    successors: dict[str, list[str]] = {}
    for number, corridor in enumerate(corridors):
        parts = len(bounds[number]) - 1
        for part in range(parts - 1):
            successors.setdefault(f"driven-{number}.{part}", []).append(f"driven-{number}.{part + 1}")
        if corridor.before is not None:
            successors.setdefault(piece(*corridor.before, ends=True), []).append(f"driven-{number}.0")
        if corridor.after is not None:
            successors.setdefault(f"driven-{number}.{parts - 1}", []).append(piece(*corridor.after, ends=False))
    for number, corridor in enumerate(corridors):
        center, width = _mean_line(corridor, width_m)
        for part, (begin, end) in enumerate(zip(bounds[number][:-1], bounds[number][1:])):
            name = f"driven-{number}.{part}"
            yield MapLane(
                lane_id=name,
                kind="drive",
                center_m=center[begin : end + 1],
                width_m=width[begin : end + 1],
                successors=tuple(dict.fromkeys(successors.get(name, ()))),
                predecessors=tuple(before for before, after in successors.items() if name in after),
            )


def _bounds(corridor: _Corridor) -> list[int]:
    """Indices at which the pieces of a corridor begin and end; pieces shorter than three metres are not cut off."""
    last = len(corridor.line) - 1
    found = [0]
    for cut in sorted(corridor.cuts):
        if cut - found[-1] >= 3 and last - cut >= 3:
            found.append(cut)
    return [*found, last]


def _mean_line(corridor: _Corridor, width_m: float) -> tuple[Float64, Float64]:
    """The mean (K, 3) of a corridor's lines, smoothed, and its width (K,)."""
    count = len(corridor.line)
    mean, low, high = np.zeros(count), np.zeros(count), np.zeros(count)
    for index, offsets in corridor.offsets.items():
        # The first line is one of the lines, at offset 0.
        mean[index] = sum(offsets) / (len(offsets) + 1)
        low[index], high[index] = min(0.0, *offsets), max(0.0, *offsets)
    window = min(_SMOOTH_M, count)
    weights = np.ones(window)
    mean = np.convolve(mean, weights, "same") / np.convolve(np.ones(count), weights, "same")
    ahead = np.gradient(corridor.line[:, :2], axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    center = corridor.line.copy()
    center[:, :2] += mean[:, None] * np.column_stack([-ahead[:, 1], ahead[:, 0]])
    return center, np.maximum(width_m, 2.0 * np.maximum(high - mean, mean - low) + VEHICLE_WIDTH_M)
