"""The routes of the recording vehicle: routes through the scene, and one for each branch of the ROI trigger."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.portable import arrays
from mirror.synth.driving.turning import build_turn_around, point_and_direction_at
from mirror.traffic.lanes.network import Network
from mirror.traffic.lanes.paths import Path, beside_m, iterate_paths, select_lanes, source_lanes, turn_rad
from mirror.traffic.lanes.ways import STEP_M, Piece, Way, build_way, change_lane_pieces, lane_piece
from mirror.traffic.placement.trace import trail_rear_axle

LEAD_M: Final = 24.0
_EDGE: Final = 0.85
_PASS_S: Final = 8.0
_SKIM_M: Final = 65.0
_CLEAR_M: Final = 26.0
_BESIDE_M: Final = 40.0
_OUTSIDE_S: Final = 2.35
_UTURN_M: Final = 27.0
_SLOW_MPS: Final = 5.0
_CHANGE_M: Final = 75.0
_VISIT_S: Final = 13.0
_QUIET_MPS: Final = 9.0


@dataclass(frozen=True, eq=False)
class DriveRoute:
    """A route of the recording vehicle.

    Attributes:
        way: way that it follows.
        begin_m: length along the way at which the drive begins.
        end_m: length at which the drive ends.
        comes_from_m: length at which the vehicle starts, before the drive begins.
        fastest_mps: speed limit of the vehicle.
        stands_s: time for which it stands at the beginning.
        first: True: the vehicle has right of way everywhere and obeys signals only, so that it keeps its times.
    """

    way: Way
    begin_m: float
    end_m: float
    comes_from_m: float = 0.0
    fastest_mps: float = math.inf
    stands_s: float = 0.0
    first: bool = False


class Streets:
    """The paths of a network, by their use for routes.

    Args:
        network: network of the scene.
        radius_m: radius of the ROI, which is centred at the origin.
        wheelbase_m: wheelbase of the vehicle.
    """

    def __init__(self, network: Network, radius_m: float, wheelbase_m: float) -> None:
        self.network = network
        self.radius_m = radius_m
        self.wheelbase_m = wheelbase_m
        lanes = select_lanes(network, "drive", "turn")
        every = [path for start in source_lanes(lanes) for path in iterate_paths(lanes, start)]
        ends = [(arrays.hypot(*path.line[0]), arrays.hypot(*path.line[-1])) for path in every]
        self.paths = [path for path, near in zip(every, ends) if min(near) > radius_m]
        through = [path for path in self.paths if not path.turns and path.inside_m(radius_m) > radius_m]
        if not through:
            raise UsageError("no street leads through the scene", expected="lanes from one side of it to the other")
        # Lanes of one carriageway have about the same length; the rightmost is the default.
        main = min(through, key=lambda path: (-round(self._worth(path) / 40.0), path.lane_ids))
        first, last = main.line[0], main.line[-1]
        self.along = self._from_right([path for path in through if _joins(path, first, last)])
        self.back = self._from_right([path for path in through if _joins(path, last, first)])

    def _worth(self, path: Path) -> float:
        return path.inside_m(self.radius_m) - 3.0 * path.closest_m

    def _from_right(self, paths: Sequence[Path]) -> list[Path]:
        """Order parallel paths from right to left."""
        return sorted(paths, key=lambda path: (float(_cross_lines(path.chord, path.line[0])), path.lane_ids))

    def across(self) -> list[Path]:
        """Return straight paths that cross the main street, longest part in the ROI first."""
        chord = self.along[0].chord
        paths = [
            path
            for path in self.paths
            if not path.turns and abs(_cross_lines(chord, path.chord)) > 0.7 and path.closest_m < _EDGE * self.radius_m
        ]
        return sorted(paths, key=lambda path: (-round(path.inside_m(self.radius_m)), path.lane_ids))

    def turning(self, sign: float) -> list[Path]:
        """Return paths that turn off the main street once, left (1) or right (-1), deepest in the ROI first."""
        starts = {path.lane_ids[0] for path in self.along}
        paths = [
            path
            for path in self.paths
            if path.lane_ids[0] in starts and len(path.turns) == 1 and sign * path.turns[0] > 0.0
        ]
        least_m = 0.8 * self.radius_m
        return sorted(
            (path for path in paths if path.inside_m(self.radius_m) > least_m),
            key=lambda path: (self._turns_at_m(path), path.lane_ids),
        )

    def _turns_at_m(self, path: Path) -> float:
        lane = max((lane for lane in path.lanes if lane.use == "turn"), key=lambda lane: abs(turn_rad(lane)))
        return round(float(arrays.hypot(*lane.line[0, :2])))

    def edge(self) -> list[Path]:
        """Return straight paths that only touch the ROI."""
        paths = [
            path
            for path in self.paths
            if not path.turns and _EDGE * self.radius_m < path.closest_m < self.radius_m - 1.0
        ]
        return sorted(paths, key=lambda path: (path.inside_m(self.radius_m), path.lane_ids))

    def skimming(self) -> list[Path]:
        """Return paths that enter the ROI for a few metres and turn away at its edge."""
        paths = [
            path
            for path in self.paths
            if len(path.turns) == 1
            and path.closest_m > _EDGE * self.radius_m
            and 5.0 < path.inside_m(self.radius_m) < _SKIM_M
        ]
        return sorted(paths, key=lambda path: (-path.inside_m(self.radius_m), path.lane_ids))

    def out_and_home(self, at_m: float) -> tuple[Path, Path]:
        """Return a path out of the ROI and a parallel path back, without a crossing where they are joined."""
        for out, home in ((self.along, self.back), (self.back, self.along)):
            if out and home:
                place, _ = point_and_direction_at(out[0], at_m)
                lane = min(out[0].lanes, key=lambda lane: float(arrays.hypot(*(lane.line[:, :2] - place).T).min()))
                at = beside_m(lane, place)
                if lane.use == "drive" and at > _CLEAR_M and (lane.length_m - at > _CLEAR_M or not lane.successors):
                    return out[0], home[0]
        raise UsageError(
            f"no room to turn round {at_m:.0f} m from the scene's middle",
            expected="a street with a lane in either direction, clear of crossings",
            remedy="take another route, or another kind of scene",
        )

    def slip(self, leaving: bool) -> list[Path]:
        """Return paths that leave the main carriageway, or join it, by a slip road."""
        main = [*self.along, *self.back]
        own, other = (0, -1) if leaving else (-1, 0)
        own_ids, other_ids = {path.lane_ids[own] for path in main}, {path.lane_ids[other] for path in main}
        paths = [
            path
            for path in self.paths
            if not path.turns and path.lane_ids[own] in own_ids and path.lane_ids[other] not in other_ids
        ]
        return sorted(paths, key=lambda path: path.lane_ids)


def _joins(path: Path, begin: Float64, end: Float64) -> bool:
    """Return whether a path leads from near one point to near another."""
    return bool(arrays.hypot(*(path.line[0] - begin)) < _BESIDE_M and arrays.hypot(*(path.line[-1] - end)) < _BESIDE_M)


def _cross_lines(a: Float64, b: Float64) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def _pick_path(paths: Sequence[Path], variant: int, route: str) -> Path:
    if not paths:
        raise UsageError(
            f"no route {route!r} in this scene",
            expected="streets that allow it",
            remedy="take 'along', 'back' or 'still', which every scene has, or another kind of scene",
        )
    return paths[variant % len(paths)]


def _make_through_route(path: Path, streets: Streets, speed_mps: float | None = None) -> DriveRoute:
    """A route along a whole path, from before the ROI to after it."""
    pieces = [lane_piece(lane) for lane in path.lanes]
    if speed_mps is not None:
        pieces = [replace(piece, speed_mps=speed_mps) for piece in pieces]
    return _through_way(build_way(pieces), streets)


def _through_way(way: Way, streets: Streets) -> DriveRoute:
    inside = STEP_M * np.flatnonzero(arrays.hypot(*way.points.T) < streets.radius_m)
    return DriveRoute(way, max(float(inside[0]) - LEAD_M, 0.0), min(float(inside[-1]) + LEAD_M + 6.0, way.length_m))


def _along_route(streets: Streets, variant: int) -> DriveRoute:
    """The whole main street."""
    return _make_through_route(_pick_path(streets.along, variant, "along"), streets)


def _back_route(streets: Streets, variant: int) -> DriveRoute:
    """The whole main street, in the other direction."""
    return _make_through_route(_pick_path(streets.back, variant, "back"), streets)


def _turn_route(streets: Streets, variant: int) -> DriveRoute:
    """Along the main street, then right at a crossing."""
    return _make_through_route(_pick_path(streets.turning(-1.0), variant, "turn"), streets)


def _left_route(streets: Streets, variant: int) -> DriveRoute:
    """Along the main street, then left at a crossing."""
    return _make_through_route(_pick_path(streets.turning(1.0), variant, "left"), streets)


def _across_route(streets: Streets, variant: int) -> DriveRoute:
    """Straight across the main street."""
    return _make_through_route(_pick_path(streets.across(), variant, "across"), streets)


def _other_direction_route(streets: Streets, variant: int) -> DriveRoute:
    """The main street, not on the rightmost lane."""
    return _make_through_route(_pick_path(streets.along[1:], variant, "other"), streets)


def _lane_change_route(streets: Streets, variant: int) -> DriveRoute:
    """The main street, with a change to the left lane and back."""
    path = _pick_path([path for path in streets.along if path.lanes[0].left], variant, "change")
    lanes = streets.network.lanes
    usable = [n for n, lane in enumerate(path.lanes) if lane.left and lane.length_m > 2.0 * _CHANGE_M]
    if not usable:
        _pick_path([], 0, "change")
    out, home = usable[0], usable[-1]
    pieces: list[Piece] = []
    for number, lane in enumerate(path.lanes):
        left = None if lane.left is None else lanes[lane.left]
        begin_m = 0.3 * lane.length_m
        if number == out and left is not None:
            pieces += change_lane_pieces(lane, left, begin_m, _CHANGE_M)
        elif out < number < home and left is not None:
            pieces.append(lane_piece(left))
        elif number == home and left is not None:
            pieces += change_lane_pieces(left, lane, begin_m, _CHANGE_M)
        else:
            pieces.append(lane_piece(lane))
    return _through_way(build_way(pieces), streets)


def _leave_route(streets: Streets, variant: int) -> DriveRoute:
    """Off the main carriageway by a slip road."""
    return _make_through_route(_pick_path(streets.slip(leaving=True), variant, "leave"), streets)


def _join_route(streets: Streets, variant: int) -> DriveRoute:
    """Onto the main carriageway by a slip road."""
    return _make_through_route(_pick_path(streets.slip(leaving=False), variant, "join"), streets)


def _edge_route(streets: Streets, variant: int) -> DriveRoute:
    """The street at the edge of the ROI: inside for 8 s."""
    path = _pick_path(streets.edge(), variant, "edge")
    speed = path.inside_m(streets.radius_m) / _PASS_S
    route = _make_through_route(path, streets, speed)
    lead = 3.0 * speed + LEAD_M
    return replace(
        route, begin_m=max(route.begin_m + LEAD_M - lead, 0.0),
        end_m=min(route.end_m - LEAD_M + lead, route.way.length_m), first=True,
    )  # fmt: skip


def _corner_route(streets: Streets, variant: int) -> DriveRoute:
    """Touches the ROI: along the street at its edge, then away from it."""
    return replace(_make_through_route(_pick_path(streets.skimming(), variant, "corner"), streets), first=True)


def _stationary_route(streets: Streets, variant: int) -> DriveRoute:
    """Stands in the ROI, then drives 14 m."""
    path = _pick_path(streets.along, variant, "still")
    way = build_way([lane_piece(lane) for lane in path.lanes])
    free = [halt.at_m for halt in way.halts]
    middle = way.nearest_m(np.zeros(2))
    # The place is away from stop lines, where the vehicle would have to wait again.
    places = [middle + sign * 5.0 * k for k in range(30) for sign in (-1.0, 1.0)]
    begin = next(place for place in places if all(not place - 6.0 < at < place + 40.0 for at in free))
    return DriveRoute(way, begin, begin + 14.0, begin, fastest_mps=2.0, stands_s=35.0, first=True)


def _repeated_route(streets: Streets, variant: int) -> DriveRoute:
    """Leaves the ROI, turns around and enters it again."""
    out, home = streets.out_and_home(streets.radius_m + 34.0)
    way, swing = build_turn_around(out, home, streets.radius_m + 34.0)
    inside = arrays.hypot(*way.points.T) < streets.radius_m
    middle = int(swing / STEP_M)
    leaves = STEP_M * float(np.flatnonzero(inside[:middle])[-1])
    comes = STEP_M * float(middle + np.argmax(inside[middle:]))
    begin, end = max(leaves - _VISIT_S * _QUIET_MPS, 0.0), min(comes + _VISIT_S * _QUIET_MPS, way.length_m)
    return DriveRoute(way, begin, end, max(begin - 40.0, 0.0), fastest_mps=_QUIET_MPS, first=True)


def _uturn_route(streets: Streets, variant: int) -> DriveRoute:
    """Turns around at the edge of the ROI: less than 3 s outside between two short visits."""
    out, home = streets.out_and_home(streets.radius_m)
    low, high = streets.radius_m - 16.0, streets.radius_m + 8.0
    # The time outside grows with the distance of the turn.
    for _ in range(16):
        apex = 0.5 * (low + high)
        way, swing = build_turn_around(out, home, apex)
        outside = arrays.hypot(*trail_rear_axle(way.points, streets.wheelbase_m).T) > streets.radius_m
        near = np.abs(np.arange(len(way.points)) * STEP_M - swing) < _UTURN_M
        seconds = float((STEP_M / np.minimum(way.pace_mps, _SLOW_MPS))[outside & near].sum())
        low, high = (apex, high) if seconds < _OUTSIDE_S else (low, apex)
    begin, end = swing - _UTURN_M, swing + _UTURN_M
    return DriveRoute(way, begin, end, begin - 13.0, fastest_mps=_SLOW_MPS, first=True)


ROUTES: Final[dict[str, Callable[[Streets, int], DriveRoute]]] = {
    "along": _along_route,
    "back": _back_route,
    "turn": _turn_route,
    "left": _left_route,
    "across": _across_route,
    "other": _other_direction_route,
    "change": _lane_change_route,
    "leave": _leave_route,
    "join": _join_route,
    "edge": _edge_route,
    "corner": _corner_route,
    "still": _stationary_route,
    "twice": _repeated_route,
    "uturn": _uturn_route,
}


def make_route(name: str, network: Network, radius_m: float, variant: int = 0, wheelbase_m: float = 2.8) -> DriveRoute:
    """Make a route by its name.

    Args:
        name: one of `ROUTES`.
        network: network of the scene.
        radius_m: radius of the ROI, which is centred at the origin.
        variant: index among the routes of that name (parallel lanes, several crossings).
        wheelbase_m: wheelbase of the vehicle; its rear axle decides when it enters and leaves the ROI.

    Raises:
        UsageError: the name does not exist, or the network has no such route.
    """
    if name not in ROUTES:
        raise UsageError(f"no route {name!r}", expected=f"one of {', '.join(ROUTES)}")
    return ROUTES[name](Streets(network, radius_m, wheelbase_m), variant)


def available_routes(network: Network, radius_m: float) -> tuple[str, ...]:
    """Return the names of the routes that exist in a network."""
    streets = Streets(network, radius_m, 2.8)
    names = []
    for name, make in ROUTES.items():
        try:
            make(streets, 0)
        except UsageError:
            continue
        names.append(name)
    return tuple(names)
