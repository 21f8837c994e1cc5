"""Models: planar faces and ellipsoids in one frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64, Records

NO_OBJECT: Final = -1
NO_IMAGE: Final = -1
MOST_CORNERS: Final = 16


class Side(IntEnum):
    """Which side of a body a face is."""

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

``normal . p = offset`` on its plane, the normal outwards; texture coordinates in metres are ``u = u_axis . p + u0`` and
``v = v_axis . p + v0``; ``half`` are half extents in them. ``first`` and ``count`` name its corners, counter-clockwise
seen from outside. ``image`` is an image of the catalogue or NO_IMAGE; where ``images`` is above 1, the image is one
of as many from ``image`` on, another in each traversal. ``layout`` is a carriageway's row of markings.
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
"""An ellipsoid. ``axes`` are its own directions as rows, in the frame that it stands in; ``half`` its half axes. An
``image`` covers the half towards its own +x, as seen from there: the right of the image is +y."""


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
        """Nothing."""
        return cls(np.zeros(0, FACE), np.zeros((0, 3)), np.zeros(0, ROUND))

    def __len__(self) -> int:
        return len(self.faces) + len(self.rounds)

    def placed(self, rotation: Float64, translation: Float64, number: int | None = None) -> Model:
        """Moved into another frame, as object ``number``.

        Args:
            rotation: (3, 3), of the motion ``dst_SE3_src``.
            translation: (3,).
            number: what its pixels are counted under; None: as before.
        """
        rotation, translation = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
        faces, rounds = joined([self.faces]), joined([self.rounds])
        for name, shift in (("normal", "offset"), ("u_axis", "u0"), ("v_axis", "v0")):
            turned = self.faces[name] @ rotation.T
            faces[name] = turned
            moved = turned @ translation
            faces[shift] = self.faces[shift] + (moved if name == "normal" else -moved)
        rounds["centre"] = self.rounds["centre"] @ rotation.T + translation
        rounds["axes"] = self.rounds["axes"] @ rotation.T
        if number is not None:
            faces["object"], rounds["object"] = number, number
        return Model(faces, self.corners @ rotation.T + translation, rounds)

    def standing(
        self, x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0, number: int | None = None
    ) -> Model:
        """Moved to a place and turned about the vertical, counter-clockwise."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return self.placed(turn, np.array([x_m, y_m, z_m]), number)

    def bounds(self) -> tuple[Float64, Float64]:
        """Least and greatest coordinates (3,) of all of it."""
        reach = np.sqrt(np.einsum("nij,ni->nj", self.rounds["axes"] ** 2, self.rounds["half"] ** 2))
        ends = np.concatenate([self.corners, self.rounds["centre"] - reach, self.rounds["centre"] + reach])
        return ends.min(axis=0), ends.max(axis=0)


def joined(parts: Sequence[Records]) -> Records:
    """Records of one kind as a new array: as bytes, ten times as fast as field by field."""
    kind = parts[0].dtype
    size = kind.itemsize
    whole: Records = np.concatenate([np.ascontiguousarray(part).view((np.void, size)) for part in parts]).view(kind)
    return whole


def merged(models: Iterable[Model]) -> Model:
    """All models as one."""
    parts = list(models)
    if not parts:
        return Model.empty()
    starts = np.cumsum([0, *(len(part.corners) for part in parts)])
    faces = joined([part.faces for part in parts])
    faces["first"] += np.repeat(starts[:-1], [len(part.faces) for part in parts])
    return Model(faces, np.concatenate([part.corners for part in parts]), joined([part.rounds for part in parts]))
