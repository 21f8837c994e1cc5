"""Collects bodywork sheets: polygons of any winding, mirrored where wanted, and converted to one model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.model import Label, Material, Model, Side, merge_models
from mirror.synth.model.polygons import polygons
from mirror.synth.model.surfaces import NO_IMAGE

Colour = Sequence[float] | Float64
Texture = Callable[[Float64], Float64]
"""Affine map from positions (N, 3) to texture coordinates (N, 2)."""


class Panel(IntEnum):
    """Details on a sheet of PAINT or GLASS besides its colour, stored as a face's ``layout``.

    On panels with doors u is 0 at the seam between the doors and 1 one door's length further ahead; v is the height
    above the waistline. On glass panels with pillars u is the same; in rows of windows every whole u is a pillar.
    """

    PLAIN = 0
    LOWER = 1
    """Dust that increases towards the ground; v as on doors. On glass: no seats are visible through it."""
    TWO_DOORS = 2
    """One door on each side, from u = 0 to 1."""
    FOUR_DOORS = 3
    """Two doors on each side, from u = -1 to 1."""
    SLIDING_DOOR = 4
    """A front door, and a wide sliding door with a rail."""
    ROW = 5
    """Windows or sheets, each 1 u long."""
    WING = 6
    """Cargo doors: a seam in the middle and hinges at the edges."""


class SheetFinish(NamedTuple):
    """Surface of a sheet: colour, material, panel, image, and whether it is visible from both sides."""

    colour: Colour
    material: Material
    panel: Panel = Panel.PLAIN
    image: int = NO_IMAGE
    two_sided: bool = False


class _Sheet(NamedTuple):
    corners: Float64
    side: Side
    finish: SheetFinish
    texture: Float64


_TOWARDS: Final[dict[Side, tuple[float, float, float]]] = {
    Side.FRONT: (1.0, 0.0, 0.0),
    Side.BACK: (-1.0, 0.0, 0.0),
    Side.LEFT: (0.0, 1.0, 0.0),
    Side.RIGHT: (0.0, -1.0, 0.0),
    Side.TOP: (0.0, 0.0, 1.0),
    Side.BOTTOM: (0.0, 0.0, -1.0),
}
_OTHER: Final = {Side.LEFT: Side.RIGHT, Side.RIGHT: Side.LEFT}


class Sheets:
    """A collector of planar convex polygons; :meth:`model` converts them to one model.

    Args:
        label: semantic class of all faces.
        seed: seed of all textures.
    """

    def __init__(self, label: Label, seed: int = 0) -> None:
        self.label, self.seed = label, seed
        self._sheets: list[_Sheet] = []
        self._models: list[Model] = []

    def sheet(
        self,
        corners: npt.ArrayLike,
        side: Side,
        finish: SheetFinish,
        *,
        texture: Texture | None = None,
        lift_m: float = 0.0,
        both: bool = False,
    ) -> None:
        """Add a polygon.

        Args:
            corners: (N, 3) metres, in either winding; the polygon is oriented to face ``side``.
            side: side of the body on which it lies.
            finish: surface of the sheet.
            texture: texture coordinates; default: metres from the middle, u horizontal to the right seen from outside,
                v up.
            lift_m: distance in front of the given corners.
            both: whether to add a mirror image on the other flank; not for finishes with images, which would be
                reversed.
        """
        points = np.asarray(corners, np.float64)
        normal = _unit_normal(points)
        if arrays.matmul(normal, _TOWARDS[side]) < 0.0:
            points, normal = points[::-1], -normal
        coordinates = _plain_texture(points, normal) if texture is None else texture(points)
        points = points + lift_m * normal
        self._sheets.append(_Sheet(points, side, finish, coordinates))
        if both:
            self._sheets.append(
                _Sheet(points[::-1] * (1.0, -1.0, 1.0), _OTHER.get(side, side), finish, coordinates[::-1]),
            )

    def block(
        self,
        low: Sequence[float],
        high: Sequence[float],
        finish: SheetFinish,
        sides: Sequence[Side],
        *,
        both: bool = False,
    ) -> None:
        """Add the given sides of an axis-aligned box between two corners."""
        (a, b, c), (d, e, f) = low, high
        for side in sides:
            axis, top = {
                Side.FRONT: (0, d), Side.BACK: (0, a), Side.LEFT: (1, e),
                Side.RIGHT: (1, b), Side.TOP: (2, f), Side.BOTTOM: (2, c),
            }[side]  # fmt: skip
            corners = np.array(
                [
                    [(top, b, c), (top, e, c), (top, e, f), (top, b, f)],
                    [(a, top, c), (d, top, c), (d, top, f), (a, top, f)],
                    [(a, b, top), (d, b, top), (d, e, top), (a, e, top)],
                ][axis]
            )
            self.sheet(corners, side, finish, both=both)

    def add(self, model: Model) -> None:
        """Add a model with other kinds of surface."""
        self._models.append(model)

    def model(self) -> Model:
        """Convert all polygons and added models to one model."""
        parts = []
        for count in sorted({len(item.corners) for item in self._sheets}):
            group = [item for item in self._sheets if len(item.corners) == count]
            part = polygons(
                np.stack([item.corners for item in group]),
                np.array([item.finish.colour for item in group], np.float64),
                Material.PLAIN,
                self.label,
                texture=np.stack([item.texture for item in group]),
                layouts=[int(item.finish.panel) for item in group],
                seeds=self.seed,
            )
            part.faces["material"] = [int(item.finish.material) for item in group]
            part.faces["side"] = [int(item.side) for item in group]
            part.faces["image"] = [item.finish.image for item in group]
            part.faces["two_sided"] = [item.finish.two_sided for item in group]
            parts.append(part)
        return merge_models([*parts, *self._models])


# Bodies have hundreds of small sheets, so numpy's overhead per sheet would dominate; plain Python is faster.


def _unit_normal(points: Float64) -> Float64:
    (x0, y0, z0), *others = points.tolist()
    nx = ny = nz = ax = ay = az = 0.0
    for x, y, z in others:
        bx, by, bz = x - x0, y - y0, z - z0
        nx, ny, nz = nx + ay * bz - az * by, ny + az * bx - ax * bz, nz + ax * by - ay * bx
        ax, ay, az = bx, by, bz
    long = math.sqrt(nx * nx + ny * ny + nz * nz)
    return np.array([nx / long, ny / long, nz / long])


def _plain_texture(points: Float64, normal: Float64) -> Float64:
    nx, ny, nz = normal.tolist()
    level = scalars.hypot(nx, ny)
    ux, uy = (1.0, 0.0) if abs(nz) > 0.999 else (-ny / level, nx / level)
    coordinates = arrays.matmul(points, np.array([(ux, -nz * uy), (uy, nz * ux), (0.0, nx * uy - ny * ux)]))
    return np.asarray(coordinates - 0.5 * (coordinates.min(axis=0) + coordinates.max(axis=0)))
