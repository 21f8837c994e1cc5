"""Bodywork of vehicles with a bonnet: flanks with wheel arches, rounded ends and a greenhouse, from a few measures.

All sheets are planar. The half width of a flank is a piecewise linear function of height (two pieces), minus a taper
towards the ends. An end consists of a front and two corners over two bands. Everything that crosses the vehicle is a
symmetric trapezoid.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.synth.model import Material, Side
from mirror.synth.road_users.coachwork.sheets import Panel, SheetFinish, Sheets

Point = tuple[float, float]
"""A point of the side view: x forward and z up, metres."""

DARK: Final = SheetFinish((0.018, 0.018, 0.019), Material.PLAIN)
PANE: Final = SheetFinish((0.012, 0.013, 0.014), Material.GLASS)
DARK_PANE: Final = PANE._replace(panel=Panel.LOWER)
_LAP_M: Final = 0.035
_LEDGE_M: Final = 0.015


@dataclass(frozen=True)
class End:
    """The front or the back of a body, with a rounded corner on each side as seen from above.

    Attributes:
        reach_m: distance of its farthest point from the body's middle.
        corner_m: length and width of a corner.
        foot_slope: outward slope with height below its farthest point.
        slope: inward slope with height above that point.
        taper: inward slope of the flank with length beyond the axle.
        rim_m: height of the bonnet or the deck at the end.
    """

    reach_m: float
    corner_m: Point
    foot_slope: float
    slope: float
    taper: float
    rim_m: float


@dataclass(frozen=True)
class Shape:
    """Measures of a body, in metres.

    Attributes:
        width_m: width without mirrors.
        clearance_m: height of the sills.
        waist_m: height at which the greenhouse stands on the flanks.
        wheel_m: radius of the wheels.
        axles_m: x of the front and the rear axle.
        front: front end.
        back: rear end.
        bonnet: points of the side view between the windscreen's foot and the front end.
        roof: points from the windscreen's foot over the roof to the rear window's foot; both feet are at the waist.
        rail_m: height above which the greenhouse's sides lean in towards the roof.
        lean: inward lean of the sides with height below the rail.
        rail_lean: inward lean of the sides above the rail.
        tuck_m: how much narrower the flanks are at the sills.
        shoulder_m: how much narrower the flanks are at the waist.
        doors: seams of the flanks.
        door_m: x of the seam at which u is 0, and the length of a door.
    """

    width_m: float
    clearance_m: float
    waist_m: float
    wheel_m: float
    axles_m: tuple[float, float]
    front: End
    back: End
    bonnet: tuple[Point, ...]
    roof: tuple[Point, ...]
    rail_m: float
    lean: float
    rail_lean: float
    tuck_m: float
    shoulder_m: float
    doors: Panel
    door_m: Point

    @cached_property
    def arch_m(self) -> float:
        """Radius of the wheel arches."""
        return 1.06 * self.wheel_m + 0.028

    @cached_property
    def levels_m(self) -> tuple[float, float, float, float]:
        """Heights between the bands of the flanks; at the second height the body is widest and longest."""
        return (
            self.clearance_m,
            self.wheel_m + 0.35 * self.arch_m,
            self.wheel_m + 0.78 * self.arch_m,
            self.wheel_m + 0.97 * self.arch_m,
        )

    @cached_property
    def crown(self) -> list[Point]:
        """The points of the roof, and the points at which the roof's line crosses the rail."""
        points = [self.roof[0]]
        for (x, z), (other_x, other_z) in pairwise(self.roof):
            if (z - self.rail_m) * (other_z - self.rail_m) < 0.0:
                points.append((x + (other_x - x) * (self.rail_m - z) / (other_z - z), self.rail_m))
            points.append((other_x, other_z))
        return points

    def open_m(self, z: float) -> float:
        """Return half the length of a wheel arch at a height."""
        return math.sqrt(max(self.arch_m**2 - (z - self.wheel_m) ** 2, 0.0))

    def flank_m(self, x: float, z: float) -> float:
        """Return half the width of the body."""
        half = 0.5 * self.width_m
        wide = np.interp(
            z,
            (self.levels_m[0], self.levels_m[1], self.waist_m),
            (half - self.tuck_m, half, half - self.shoulder_m),
        )
        ahead, behind = max(x - self.axles_m[0], 0.0), max(self.axles_m[1] - x, 0.0)
        return float(wide) - self.front.taper * ahead - self.back.taper * behind

    def side_m(self, z: float) -> float:
        """Return half the width of the greenhouse."""
        foot = 0.5 * self.width_m - self.shoulder_m - _LEDGE_M
        return foot - self.lean * (min(z, self.rail_m) - self.waist_m) - self.rail_lean * max(z - self.rail_m, 0.0)

    def flank(self, x: float, z: float) -> tuple[float, float, float]:
        """Return a point on the left flank."""
        return x, self.flank_m(x, z), z

    def side(self, x: float, z: float) -> tuple[float, float, float]:
        """Return a point on the left side of the greenhouse."""
        return x, self.side_m(z), z

    def screen(self, z: float) -> float:
        """Return the x of the windscreen at a height."""
        return _x_at(self.roof[0], self.roof[1], z)

    def rear_window(self, z: float) -> float:
        """Return the x of the rear window at a height."""
        return _x_at(self.roof[-1], self.roof[-2], z)

    def corner(self, end: End, z: float) -> Float64:
        """Return the point at which the left flank ends."""
        sign = 1.0 if end is self.front else -1.0
        above = z - self.levels_m[1]
        x = sign * (end.reach_m - end.corner_m[0] + (end.foot_slope if above < 0.0 else -end.slope) * above)
        return np.array(self.flank(x, z))

    def corner_point(self, end: End, share: float, z: float) -> Float64:
        """Return a point on the left corner; share 0 is at the front, 1 at the flank."""
        sign = 1.0 if end is self.front else -1.0
        return self.corner(end, z) + (1.0 - share) * np.array([sign * end.corner_m[0], -end.corner_m[1], 0.0])

    def face(self, end: End, share: float, z: float) -> Float64:
        """Return a point on the face of an end; share 0 is in the middle, 1 where the left corner begins."""
        return self.corner_point(end, 0.0, z) * (1.0, share, 1.0)

    def flank_texture(self, places: Float64) -> Float64:
        """Return the texture coordinates of flanks: door lengths, and the height above the waist."""
        return np.c_[(places[:, 0] - self.door_m[0]) / self.door_m[1], places[:, 2] - self.waist_m]

    def end_texture(self, places: Float64) -> Float64:
        """Return the texture coordinates of ends: metres to the left, and the height above the waist."""
        return np.c_[places[:, 1], places[:, 2] - self.waist_m]


def _x_at(foot: Point, top: Point, z: float) -> float:
    return foot[0] + (top[0] - foot[0]) * (z - foot[1]) / (top[1] - foot[1])


def add_shell(
    sheets: Sheets,
    shape: Shape,
    paint: SheetFinish,
    *,
    sill: SheetFinish,
    deck: SheetFinish,
    screen: SheetFinish = PANE,
) -> None:
    """Add flanks, ends, bonnet, deck, greenhouse and the dark parts behind the wheels.

    Args:
        sheets: the sheets to add to.
        shape: measures of the body.
        paint: finish of the body.
        sill: finish of the lowest band of flanks and ends.
        deck: finish behind the rear window.
        screen: finish of the windscreen.
    """
    _add_flanks(sheets, shape, paint, sill)
    for end in (shape.front, shape.back):
        _add_end(sheets, shape, end, paint, sill, paint if end is shape.front else deck)
    _add_greenhouse(sheets, shape, paint, screen)
    inner = 0.5 * shape.width_m - 0.27
    low, high = shape.levels_m[0], shape.levels_m[3] + 0.02
    sheets.block(
        (0.25 - shape.back.reach_m, -inner, low),
        (shape.front.reach_m - 0.3, inner, high),
        DARK,
        (Side.LEFT,),
        both=True,
    )


def _add_flanks(sheets: Sheets, shape: Shape, paint: SheetFinish, sill: SheetFinish) -> None:
    front, back = shape.axles_m
    levels = shape.levels_m
    plain, doors = paint._replace(panel=Panel.LOWER), paint._replace(panel=shape.doors)
    for band, (low, high) in enumerate(pairwise(levels)):
        under, over = shape.open_m(low), shape.open_m(high)
        for x, end in ((front, shape.front), (back, shape.back)):
            out = 1.0 if end is shape.front else -1.0
            _add_flank(
                sheets,
                shape,
                [
                    shape.flank(x + out * under, low),
                    shape.corner(end, low),
                    shape.corner(end, high),
                    shape.flank(x + out * over, high),
                ],
                sill if band == 0 else plain,
            )
        ends = ((back + under, low), (front - under, low), (front - over, high), (back + over, high))
        _add_flank(sheets, shape, [shape.flank(*end) for end in ends], sill if band == 0 else doors)
    crest = [*_side_line(shape, shape.back)[::-1], *_side_line(shape, shape.front)]
    low = levels[3]
    for start, stop in ((None, back), (back, front), (front, None)):
        left = shape.corner(shape.back, low) if start is None else np.array(shape.flank(start, low))
        right = shape.corner(shape.front, low) if stop is None else np.array(shape.flank(stop, low))
        over_left = crest[0] if start is None else (start, _height_at(crest, start))
        over_right = crest[-1] if stop is None else (stop, _height_at(crest, stop))
        between = [point for point in crest if over_left[0] + 1e-6 < point[0] < over_right[0] - 1e-6]
        top = [over_left, *between, over_right]
        _add_flank(sheets, shape, [left, right, *(shape.flank(*point) for point in top[::-1])], doors)


def _add_flank(
    sheets: Sheets, shape: Shape, corners: list[tuple[float, float, float] | Float64], finish: SheetFinish
) -> None:
    sheets.sheet(np.array(corners), Side.LEFT, finish, texture=shape.flank_texture, both=True)


def _side_line(shape: Shape, end: End) -> list[Point]:
    """Side view of the surface between the greenhouse and an end: from the greenhouse to the end of the flank."""
    points = [shape.roof[0], *shape.bonnet] if end is shape.front else [shape.roof[-1]]
    sign = 1.0 if end is shape.front else -1.0
    x, z = points[-1]
    fall = (end.rim_m - z) / (end.reach_m - sign * x)
    top = _intersect(points[-1], sign * fall, shape.corner(end, shape.levels_m[1]), sign * -end.slope)
    return [*points, (float(top[0]), float(top[2]))]


def _intersect(point: Point, fall: float, foot: Float64, lean: float) -> Float64:
    """Intersection of a line that falls from a point with an edge that leans from its foot."""
    x, z = point
    height = (z + fall * (foot[0] - x) - foot[2]) / (1.0 - fall * lean)
    return foot + height * np.array([lean, 0.0, 1.0])


def _height_at(line: list[Point], x: float) -> float:
    return float(np.interp(x, [point[0] for point in line], [point[1] for point in line]))


def _add_end(sheets: Sheets, shape: Shape, end: End, paint: SheetFinish, sill: SheetFinish, lid: SheetFinish) -> None:
    """Add the front or the back, and the bonnet or the deck between it and the greenhouse."""
    side = Side.FRONT if end is shape.front else Side.BACK
    sign = 1.0 if end is shape.front else -1.0
    line = _side_line(shape, end)
    axle = shape.axles_m[0] if end is shape.front else shape.axles_m[1]
    if sign * (line[0][0] - axle) < 0.0 and all(abs(axle - x) > 0.02 for x, _ in line):
        level = [point for point in line if sign * (point[0] - axle) < 0.0]
        ordered = sorted(line)
        line = [*level, (axle, _height_at(ordered, axle)), *line[len(level) :]]
    for (x, z), (other_x, other_z) in pairwise(line[:-1]):
        sheets.sheet(_trapezoid(shape.flank(x, z), shape.flank(other_x, other_z)), Side.TOP, lid)
    (x, z), (edge_x, edge_z) = line[-2], line[-1]
    fall = (edge_z - z) / (edge_x - x)
    low, middle = shape.levels_m[:2]
    edge = np.array(shape.flank(edge_x, edge_z))
    rim = _intersect((x, z), fall, shape.corner_point(end, 0.0, middle), -sign * end.slope)
    rim = shape.corner_point(end, 0.0, float(rim[2]))
    half = [np.array(shape.flank(x, z)), edge, rim]
    sheets.sheet([*half, *(point * (1.0, -1.0, 1.0) for point in half[::-1])], Side.TOP, lid)
    lower = sill._replace(panel=Panel.LOWER)
    upper = paint._replace(panel=Panel.LOWER)
    for foot, top, finish in ((low, None, lower), (middle, rim, upper)):
        front = shape.corner_point(end, 0.0, foot)
        over = shape.corner_point(end, 0.0, middle) if top is None else top
        sheets.sheet(_trapezoid(front, over), side, finish, texture=shape.end_texture)
        flank = shape.corner(end, foot)
        over_flank = shape.corner(end, middle) if top is None else edge
        sheets.sheet([flank, front, over, over_flank], side, finish, texture=shape.end_texture, both=True)


def _trapezoid(low: tuple[float, float, float] | Float64, high: tuple[float, float, float] | Float64) -> Float64:
    """The symmetric trapezoid between two edges across the vehicle, given by their left ends."""
    mirror = np.array([1.0, -1.0, 1.0])
    low_edge, high_edge = np.asarray(low), np.asarray(high)
    return np.array([low_edge, low_edge * mirror, high_edge * mirror, high_edge])


def _add_greenhouse(sheets: Sheets, shape: Shape, paint: SheetFinish, screen: SheetFinish) -> None:
    waist, rail = shape.waist_m, shape.rail_m
    front, back = shape.roof[0][0], shape.roof[-1][0]
    crown = shape.crown
    lower = [(back, waist - _LAP_M), (front, waist - _LAP_M), *(point for point in crown if point[1] <= rail)]
    sheets.sheet([shape.side(*point) for point in lower], Side.LEFT, paint, both=True)
    upper = [point for point in crown if point[1] >= rail]
    sheets.sheet([shape.side(*point) for point in upper], Side.LEFT, paint, both=True)
    first, last = crown.index(shape.roof[1]), crown.index(shape.roof[-2])
    for here, there in pairwise(crown[first : last + 1]):
        sheets.sheet(_trapezoid(shape.side(*here), shape.side(*there)), Side.TOP, paint)
    sheets.sheet(window_corners(shape, shape.screen, waist, shape.roof[1][1]), Side.FRONT, screen)
    sheets.sheet(window_corners(shape, shape.rear_window, waist, shape.roof[-2][1]), Side.BACK, paint)


def window_corners(
    shape: Shape, line: Callable[[float], float], low: float, high: float, inset_m: float = 0.0
) -> Float64:
    """Return the corners of a window across the vehicle between two heights, inset by ``inset_m`` from its edges."""
    heights = [low, shape.rail_m, high] if low < shape.rail_m < high else [low, high]
    left = np.array([(line(z), shape.side_m(z) - inset_m, z) for z in heights])
    return np.concatenate([left, left[::-1] * (1.0, -1.0, 1.0)])
