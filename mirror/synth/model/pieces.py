"""Collects polygons and builds one model of them at the end, a hundred times faster than building them one by one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64
from mirror.portable import arrays
from mirror.synth.model.labels import Label
from mirror.synth.model.materials import Material
from mirror.synth.model.polygons import polygons
from mirror.synth.model.surfaces import FACE, NO_IMAGE, Model, merge_models

Place = Sequence[float] | Float64
Way = Literal["-x", "+x", "-y", "+y", "-z", "+z"]
Corners = Sequence[Place] | Float64

_WAYS: Final[dict[Way, tuple[int, int, int, int]]] = {
    "-x": (3, 0, 4, 7),
    "+x": (1, 2, 6, 5),
    "-y": (0, 1, 5, 4),
    "+y": (2, 3, 7, 6),
    "-z": (3, 2, 1, 0),
    "+z": (4, 5, 6, 7),
}


class Finish(NamedTuple):
    """The surface properties of a polygon.

    Attributes:
        colour: linear reflectance of red, green and blue.
        material: material of the surface.
        label: semantic class of the surface.
        seed: seed of the texture.
        layout: row of markings or of window patterns.
        image: image of the catalogue.
        images: number of consecutive images, from ``image`` on, that alternate between traversals.
        two_sided: whether the surface is visible from both sides.
    """

    colour: Place
    material: Material
    label: Label
    seed: int = 0
    layout: int = 0
    image: int = NO_IMAGE
    images: int = 1
    two_sided: bool = False


class Pieces:
    """A collector of polygons; :meth:`model` builds one model from all, in the order of their addition.

    u runs along the first edge of a polygon, v is 90 degrees counter-clockwise from it; both are 0 in the middle of
    the polygon's extents.
    """

    def __init__(self) -> None:
        self._corners: dict[int, list[Corners]] = {}
        self._finishes: dict[int, list[Finish]] = {}
        self._numbers: dict[int, list[int]] = {}
        self._models: list[Model] = []
        self._count = 0

    def face(self, corners: Corners, finish: Finish) -> int:
        """Add a planar convex polygon (N, 3), counter-clockwise seen from outside; returns its number."""
        count = len(corners)
        self._corners.setdefault(count, []).append(corners)
        self._finishes.setdefault(count, []).append(finish)
        self._numbers.setdefault(count, []).append(self._count)
        self._count += 1
        return self._count - 1

    def wall(
        self, left: tuple[float, float], right: tuple[float, float], low_m: float, high_m: float, finish: Finish
    ) -> int:
        """Add an upright rectangle between two points (x, y), left and right as seen from outside."""
        return self.face(
            ((*left, low_m), (*right, low_m), (*right, high_m), (*left, high_m)),
            finish,
        )

    def level(self, low: tuple[float, float], high: tuple[float, float], z_m: float, finish: Finish) -> int:
        """Add a horizontal rectangle that faces up."""
        (a, b), (c, d) = low, high
        return self.face(((a, b, z_m), (c, b, z_m), (c, d, z_m), (a, d, z_m)), finish)

    def block(self, low: Place, high: Place, finish: Finish, without: Iterable[Way] = ("-z",)) -> None:
        """Add an axis-aligned box between two corners, without some of its sides."""
        (a, b, c), (d, e, f) = low, high
        corners = ((a, b, c), (d, b, c), (d, e, c), (a, e, c), (a, b, f), (d, b, f), (d, e, f), (a, e, f))
        left_out = set(without)
        for way, order in _WAYS.items():
            if way not in left_out:
                self.face([corners[k] for k in order], finish)

    def prism(
        self,
        outline: npt.ArrayLike,
        low_m: float,
        high_m: float,
        finish: Finish,
        *,
        top: Finish | None = None,
        bottom: bool = False,
    ) -> None:
        """Add a vertical prism over a convex outline (N, 2), counter-clockwise; its top may have another finish."""
        points = [(float(x), float(y)) for x, y in np.asarray(outline)]
        for left, right in zip(points, points[1:] + points[:1]):
            self.wall(left, right, low_m, high_m, finish)
        self.face([(x, y, high_m) for x, y in points], finish if top is None else top)
        if bottom:
            self.face([(x, y, low_m) for x, y in reversed(points)], finish)

    def tube(
        self,
        start: Place,
        end: Place,
        radius_m: float,
        finish: Finish,
        *,
        end_radius_m: float | None = None,
        corners: int = 6,
        cap: bool = False,
    ) -> None:
        """Add a straight tube; u runs around it, v along it; ``cap`` closes its end."""
        first, last = np.asarray(start, np.float64), np.asarray(end, np.float64)
        x, y, z = ((last - first) / math.dist(first, last)).tolist()
        # A perpendicular direction: the cross product with the x axis, or with the y axis for a tube along x.
        across = (0.0, z, -y) if abs(x) < 0.7 else (-z, 0.0, x)
        size = arrays.norm(across)
        a, b, c = (part / size for part in across)
        angle = 2.0 * math.pi * (np.arange(corners) + 0.5) / corners
        ring = np.outer(arrays.cos(angle), (a, b, c)) + np.outer(
            arrays.sin(angle), (y * c - z * b, z * a - x * c, x * b - y * a)
        )
        low, high = first + radius_m * ring, last + (radius_m if end_radius_m is None else end_radius_m) * ring
        for i in range(corners):
            j = (i + 1) % corners
            self.face(np.stack([low[i], low[j], high[j], high[i]]), finish)
        if cap:
            self.face(high, finish)

    def add(self, model: Model) -> None:
        """Add a model; its surfaces come after all polygons."""
        self._models.append(model)

    def model(self) -> Model:
        """Build the model of all polygons and added models.

        Raises:
            UsageError: a polygon has no area.
        """
        parts = []
        for count, corners in self._corners.items():
            finishes = self._finishes[count]
            part = polygons(
                np.array(corners, np.float64),
                np.array([finish_i.colour for finish_i in finishes], np.float64),
                np.array([finish_i.material for finish_i in finishes]),
                np.array([finish_i.label for finish_i in finishes]),
                layouts=[finish_i.layout for finish_i in finishes],
                seeds=[finish_i.seed for finish_i in finishes],
            )
            part.faces["image"] = [finish_i.image for finish_i in finishes]
            part.faces["images"] = [finish_i.images for finish_i in finishes]
            part.faces["two_sided"] = [finish_i.two_sided for finish_i in finishes]
            parts.append(part)
        gathered = merge_models(parts)
        faces = np.zeros(self._count, FACE)
        if parts:
            faces[np.concatenate(list(self._numbers.values()))] = gathered.faces
        return merge_models([Model(faces, gathered.corners, gathered.rounds), *self._models])
