"""Models: planar faces and ellipsoids in one frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final

import numpy as np

from mirror.arrays import Bool, Float64, Records
from mirror.portable import arrays

NO_OBJECT: Final = -1
NO_IMAGE: Final = -1
MOST_CORNERS: Final = 16


class Side(IntEnum):
    """The side of a body that a face belongs to."""

    FRONT = 0
    BACK = 1
    LEFT = 2
    RIGHT = 3
    TOP = 4
    BOTTOM = 5
    NONE = 6


FACE: Final = np.dtype(
    [
        ("normal", np.float64, 3),
        ("offset", np.float64),
        ("u_axis", np.float64, 3),
        ("u0", np.float64),
        ("v_axis", np.float64, 3),
        ("v0", np.float64),
        ("half", np.float64, 2),
        ("colour", np.float64, 3),
        ("first", np.int64),
        ("count", np.int64),
        ("material", np.int64),
        ("label", np.int64),
        ("side", np.int64),
        ("image", np.int64),
        ("images", np.int64),
        ("layout", np.int64),
        ("seed", np.int64),
        ("object", np.int64),
        ("lights", np.int64),
        ("two_sided", np.int64),
    ]
)
"""A planar convex polygon.

Points p of its plane satisfy ``normal . p = offset``; the normal points outwards. Texture coordinates in metres are
``u = u_axis . p + u0`` and ``v = v_axis . p + v0``; ``half`` holds the half extents in them. ``first`` and ``count``
give its corners, counter-clockwise seen from outside. ``image`` is an image of the catalogue or NO_IMAGE; if ``images``
is above 1, traversals alternate between that many consecutive images. ``layout`` is a row of markings or windows.
"""

ROUND: Final = np.dtype(
    [
        ("centre", np.float64, 3),
        ("axes", np.float64, (3, 3)),
        ("half", np.float64, 3),
        ("colour", np.float64, 3),
        ("material", np.int64),
        ("label", np.int64),
        ("image", np.int64),
        ("seed", np.int64),
        ("object", np.int64),
    ]
)
"""An ellipsoid. ``axes`` holds the directions of its axes as rows, in the frame of the model; ``half`` the semi-axes.
An ``image`` covers the half towards the ellipsoid's +x; the right side of the image is towards +y."""


@lru_cache
def flat(kind: np.dtype[np.void]) -> np.dtype[np.void]:
    """Return a record type with the same memory layout and one field per number, such as ``axes_00``.

    Compiled kernels read such fields directly; an array within a record costs two reference counts.
    """
    names: list[tuple[str, np.dtype[Any]]] = []
    for name in kind.names or ():
        field = kind[name]
        for index in np.ndindex(field.shape):
            digits = "".join(map(str, index))
            names.append((f"{name}_{digits}" if digits else name, field.base))
    return np.dtype(names)


@dataclass(frozen=True)
class Model:
    """Faces and ellipsoids in one frame.

    Attributes:
        faces: (F,) FACE.
        corners: (C, 3) metres.
        rounds: (R,) ROUND.
    """

    faces: Records
    corners: Float64
    rounds: Records

    @classmethod
    def empty(cls) -> Model:
        """Return a model without surfaces."""
        return cls(np.zeros(0, FACE), np.zeros((0, 3)), np.zeros(0, ROUND))

    def __len__(self) -> int:
        return len(self.faces) + len(self.rounds)

    def transform(self, rotation: Float64, translation: Float64, number: int | None = None) -> Model:
        """Transform the model into another frame.

        Args:
            rotation: (3, 3) rotation of ``dst_SE3_src``.
            translation: (3,) translation of ``dst_SE3_src``, metres.
            number: object number of all surfaces; None: unchanged.
        """
        rotation, translation = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
        faces, rounds = join_parts([self.faces]), join_parts([self.rounds])
        for name, shift in (("normal", "offset"), ("u_axis", "u0"), ("v_axis", "v0")):
            turned = arrays.matmul(self.faces[name], rotation.T)
            faces[name] = turned
            moved = arrays.matmul(turned, translation)
            faces[shift] = self.faces[shift] + (moved if name == "normal" else -moved)
        rounds["centre"] = arrays.matmul(self.rounds["centre"], rotation.T) + translation
        rounds["axes"] = arrays.matmul(self.rounds["axes"], rotation.T)
        if number is not None:
            faces["object"], rounds["object"] = number, number
        return Model(faces, arrays.matmul(self.corners, rotation.T) + translation, rounds)

    def place(self, x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0, number: int | None = None) -> Model:
        """Translate the model, after a counter-clockwise rotation about the vertical."""
        cos, sin = arrays.cos(yaw_rad), arrays.sin(yaw_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return self.transform(turn, np.array([x_m, y_m, z_m]), number)

    def bounds(self) -> tuple[Float64, Float64]:
        """Return the least and greatest coordinates (3,) of all surfaces."""
        reach = self._reach_of_rounds()
        ends = np.concatenate([self.corners, self.rounds["centre"] - reach, self.rounds["centre"] + reach])
        return ends.min(axis=0), ends.max(axis=0)

    def surface_bounds(self) -> tuple[Float64, Float64]:
        """Return the least and greatest coordinates (N, 3) of each surface: faces first, then ellipsoids."""
        first, count = self.faces["first"], self.faces["count"]
        low = self.corners[first]
        high = low.copy()
        for number in range(1, count.max(initial=1)):
            corner = self.corners[first + np.minimum(number, count - 1)]
            np.minimum(low, corner, out=low)
            np.maximum(high, corner, out=high)
        centre, reach = self.rounds["centre"], self._reach_of_rounds()
        return np.concatenate([low, centre - reach]), np.concatenate([high, centre + reach])

    def select(self, keep: Bool) -> Model:
        """Return the surfaces (N,) of a mask in their order; corners stay unchanged."""
        return Model(self.faces[keep[: len(self.faces)]], self.corners, self.rounds[keep[len(self.faces) :]])

    def _reach_of_rounds(self) -> Float64:
        """Half the size (R, 3) of each ellipsoid along the axes of the frame."""
        return np.sqrt(np.einsum("nij,ni->nj", self.rounds["axes"] ** 2, self.rounds["half"] ** 2))


def join_parts(parts: Sequence[Records]) -> Records:
    """Concatenate records of one type; copying bytes is ten times as fast as copying fields."""
    kind = parts[0].dtype
    size = kind.itemsize
    concatenated: Records = np.concatenate([np.ascontiguousarray(part).view((np.void, size)) for part in parts]).view(
        kind
    )
    return concatenated


def merge_models(models: Iterable[Model]) -> Model:
    """Merge models into one."""
    parts = list(models)
    if not parts:
        return Model.empty()
    starts = np.cumsum([0, *(len(part.corners) for part in parts)])
    faces = join_parts([part.faces for part in parts])
    faces["first"] += np.repeat(starts[:-1], [len(part.faces) for part in parts])
    return Model(faces, np.concatenate([part.corners for part in parts]), join_parts([part.rounds for part in parts]))
