"""The solids that everything is built of, and where a ray meets them.

A solid has a local frame: `axes` are its rows, in the frame that it stands in, and `half` its half extents. The exact
distance along a ray comes in closed form for each shape, so that depth has no tessellation error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numba import njit

from mirror.arrays import Float64, Records

BLOCK: Final = 0
"""A box whose ends may slope: at height z its ends stand at ``+-(half_x - slope * (z + half_z))``."""
ELLIPSOID: Final = 1
CYLINDER: Final = 2
"""Round about its y axis; ``half`` is radius, half length, radius."""

(
    FACADE,
    ROOF,
    BARK,
    LEAVES,
    PAINT,
    GLASS,
    TYRE,
    CLOTH,
    SKIN,
    METAL,
    LAMP,
    SKYLINE,
    CONTAINER,
) = range(13)

FRONT, BACK, LEFT, RIGHT, TOP, BOTTOM, ROUND = range(7)

SOLID: Final = np.dtype(
    [
        ("centre", np.float64, 3),
        ("axes", np.float64, (3, 3)),
        ("half", np.float64, 3),
        ("slope", np.float64, 2),
        ("colour", np.float64, 3),
        ("shape", np.int64),
        ("material", np.int64),
        ("seed", np.int64),
        ("object", np.int64),
        ("lights", np.int64),
    ]
)
NO_OBJECT: Final = -1


@lru_cache
def flat(kind: np.dtype[np.void]) -> np.dtype[np.void]:
    """The same memory with a field for every number: ``axes`` becomes ``axes_00`` to ``axes_22``.

    Compiled kernels read such fields at once; an array within a record costs them two counts of references.
    """
    names: list[tuple[str, np.dtype[Any]]] = []
    for name in kind.names or ():
        field = kind[name]
        for index in np.ndindex(field.shape):
            digits = "".join(map(str, index))
            names.append((f"{name}_{digits}" if digits else name, field.base))
    return np.dtype(names)


def solid(
    centre: Sequence[float],
    size: Sequence[float],
    colour: Sequence[float] | Float64,
    material: int,
    *,
    shape: int = BLOCK,
    slope: tuple[float, float] = (0.0, 0.0),
    yaw: float = 0.0,
    seed: int = 0,
) -> Records:
    """One solid, as an array of one.

    Args:
        centre: of its extents, metres.
        size: full extents along its own axes, metres.
        colour: linear reflectance, 0 to 1, of red, green and blue.
        material: one of this module's materials.
        shape: BLOCK, ELLIPSOID or CYLINDER.
        slope: how much the front and the back lean in, metres a metre.
        yaw: turn about z, radians, counter-clockwise.
        seed: tells its texture from its neighbours'.
    """
    one = np.zeros(1, SOLID)
    cos, sin = math.cos(yaw), math.sin(yaw)
    one["centre"], one["half"] = centre, np.asarray(size) / 2.0
    one["axes"] = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]
    one["slope"], one["colour"] = slope, colour
    one["shape"], one["material"], one["seed"], one["object"] = shape, material, seed, NO_OBJECT
    return one


def placed(solids: Records, rotation: Float64, translation: Float64, number: int) -> Records:
    """Solids moved from their own frame into another, as object ``number``.

    Args:
        solids: (N,) SOLID.
        rotation: (3, 3), of the motion ``dst_SE3_src``.
        translation: (3,).
        number: what their pixels are counted under.
    """
    moved = solids.copy()
    moved["centre"] = solids["centre"] @ rotation.T + translation
    moved["axes"] = solids["axes"] @ rotation.T
    moved["object"] = number
    return moved


def radius_m(solids: Records) -> Float64:
    """Radii (N,) of spheres about the centres that hold the solids."""
    return np.asarray(np.sqrt(np.sum(solids["half"] ** 2, axis=1)))


@njit(cache=True, nogil=True, error_model="numpy")
def meet(
    one: Records, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, far: float
) -> tuple[float, int]:
    """Distance at which a ray enters a solid, and the face; ``far`` and -1 where it does not before ``far``.

    A ray that starts inside meets nothing: no camera looks out of a solid.
    """
    x, y, z = ox - one.centre_0, oy - one.centre_1, oz - one.centre_2
    px = one.axes_00 * x + one.axes_01 * y + one.axes_02 * z
    py = one.axes_10 * x + one.axes_11 * y + one.axes_12 * z
    pz = one.axes_20 * x + one.axes_21 * y + one.axes_22 * z
    vx = one.axes_00 * dx + one.axes_01 * dy + one.axes_02 * dz
    vy = one.axes_10 * dx + one.axes_11 * dy + one.axes_12 * dz
    vz = one.axes_20 * dx + one.axes_21 * dy + one.axes_22 * dz
    if one.shape == BLOCK:
        return _meet_block(px, py, pz, vx, vy, vz, one, far)
    if one.shape == ELLIPSOID:
        a = (vx / one.half_0) ** 2 + (vy / one.half_1) ** 2 + (vz / one.half_2) ** 2
        b = px * vx / one.half_0**2 + py * vy / one.half_1**2 + pz * vz / one.half_2**2
        c = (px / one.half_0) ** 2 + (py / one.half_1) ** 2 + (pz / one.half_2) ** 2 - 1.0
        inside = b * b - a * c
        if inside < 0.0 or c < 0.0:
            return far, -1
        t = (-b - math.sqrt(inside)) / a
        return (t, ROUND) if 0.0 < t < far else (far, -1)
    return _meet_cylinder(px, py, pz, vx, vy, vz, one.half_0, one.half_1, far)


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_block(
    px: float,
    py: float,
    pz: float,
    vx: float,
    vy: float,
    vz: float,
    one: Records,
    far: float,
) -> tuple[float, int]:
    # A ray along a slab divides by zero, which gives infinities of the right sign.
    inverse = 1.0 / vy
    first, second = (-one.half_1 - py) * inverse, (one.half_1 - py) * inverse
    enter, leave, face = min(first, second), max(first, second), RIGHT if vy > 0.0 else LEFT
    inverse = 1.0 / vz
    first, second = (-one.half_2 - pz) * inverse, (one.half_2 - pz) * inverse
    if min(first, second) > enter:
        enter, face = min(first, second), BOTTOM if vz > 0.0 else TOP
    leave = min(leave, max(first, second))
    for end in range(2):
        sign = 1.0 if end == FRONT else -1.0
        lean = one.slope_0 if end == FRONT else one.slope_1
        rate = sign * vx + lean * vz
        room = one.half_0 - sign * px - lean * (pz + one.half_2)
        if rate < 0.0:
            if room / rate > enter:
                enter, face = room / rate, end
        elif rate > 0.0:
            leave = min(leave, room / rate)
        elif room < 0.0:
            return far, -1
    return (enter, face) if 0.0 < enter < leave and enter < far else (far, -1)


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_cylinder(
    px: float, py: float, pz: float, vx: float, vy: float, vz: float, radius: float, length: float, far: float
) -> tuple[float, int]:
    enter, leave, face = 0.0, far, -1
    a = vx * vx + vz * vz
    b = px * vx + pz * vz
    c = px * px + pz * pz - radius * radius
    if a > 0.0:
        inside = b * b - a * c
        if inside <= 0.0:
            return far, -1
        root = math.sqrt(inside)
        leave = min(leave, (-b + root) / a)
        if (-b - root) / a > enter:
            enter, face = (-b - root) / a, ROUND
    elif c > 0.0:
        return far, -1
    for side in (LEFT, RIGHT):
        sign = 1.0 if side == LEFT else -1.0
        d, v = sign * py - length, sign * vy
        if v < 0.0:
            if -d / v > enter:
                enter, face = -d / v, side
        elif v > 0.0:
            leave = min(leave, -d / v)
        elif d > 0.0:
            return far, -1
    return (enter, face) if face >= 0 and enter < leave else (far, -1)


@njit(cache=True, nogil=True, error_model="numpy")
def local(one: Records, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A point in a solid's own frame."""
    x, y, z = x - one.centre_0, y - one.centre_1, z - one.centre_2
    return (
        one.axes_00 * x + one.axes_01 * y + one.axes_02 * z,
        one.axes_10 * x + one.axes_11 * y + one.axes_12 * z,
        one.axes_20 * x + one.axes_21 * y + one.axes_22 * z,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def normal(one: Records, face: int, px: float, py: float, pz: float) -> tuple[float, float, float]:
    """The outward unit normal at a point (px, py, pz) of the solid's own frame, in the frame it stands in."""
    nx, ny, nz = 0.0, 0.0, 0.0
    if face == FRONT:
        nx, nz = 1.0, one.slope_0
    elif face == BACK:
        nx, nz = -1.0, one.slope_1
    elif face == LEFT:
        ny = 1.0
    elif face == RIGHT:
        ny = -1.0
    elif face == TOP:
        nz = 1.0
    elif face == BOTTOM:
        nz = -1.0
    elif one.shape == ELLIPSOID:
        nx, ny, nz = px / one.half_0**2, py / one.half_1**2, pz / one.half_2**2
    else:
        nx, nz = px, pz
    scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    return (
        scale * (one.axes_00 * nx + one.axes_10 * ny + one.axes_20 * nz),
        scale * (one.axes_01 * nx + one.axes_11 * ny + one.axes_21 * nz),
        scale * (one.axes_02 * nx + one.axes_12 * ny + one.axes_22 * nz),
    )
