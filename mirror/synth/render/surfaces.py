"""Joins the surfaces of an instant, fixed ones and those that move, in arrays that hold one instant after the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from mirror.arrays import Float64, Int64, Records
from mirror.synth.model import FACE, ROUND, Model, flat
from mirror.synth.model.surfaces import join_parts
from mirror.synth.render.binning import bounding_spheres


class SurfaceBuffer:
    """Arrays of all surfaces, in which those of an instant overwrite those of the instant before.

    The fixed surfaces, 10 MB of a street, are copied once, and what moves is written behind them. One thread at a time.
    """

    def __init__(self) -> None:
        self._fixed: Model | None = None
        self._spheres: Float64 = np.zeros((0, 9))
        self._room = (0, 0, 0)
        self._lit: Int64 = np.zeros(0, np.int64)

    def join(self, fixed: Model, spheres: Float64, moving: Model, lit: Int64) -> dict[str, Any]:
        """Join what moves to the fixed surfaces.

        Args:
            fixed: the fixed surfaces.
            spheres: (F + R, 9) their bounding spheres.
            moving: the surfaces that move.
            lit: fixed faces, of traffic lights, that are lit.

        Returns:
            The ``faces``, ``corners``, ``rounds`` and ``spheres`` of `Surroundings`.
        """
        sizes = len(moving.faces), len(moving.corners), len(moving.rounds)
        if self._fixed is not fixed or any(size > room for size, room in zip(sizes, self._room, strict=True)):
            self._copy(fixed, spheres, sizes)
        face_count, corner_count, round_count = len(fixed.faces), len(fixed.corners), len(fixed.rounds)
        faces, corners = self._faces[: face_count + sizes[0]], self._corners[: corner_count + sizes[1]]
        rounds = self._rounds[: round_count + sizes[2]]
        corners[corner_count:] = moving.corners
        for records, count, part in ((faces, face_count, moving.faces), (rounds, round_count, moving.rounds)):
            # Bytes are copied ten times as fast as fields.
            records[count:].view(np.uint8)[:] = np.ascontiguousarray(part).view(np.uint8)
        faces["first"][face_count:] += corner_count
        faces["lights"][self._lit] = fixed.faces["lights"][self._lit]
        faces["lights"][lit] = 1
        self._lit = lit
        # Ellipsoids come after all faces, so the spheres of both models are interleaved.
        there = bounding_spheres(moving.faces.view(flat(FACE)), moving.corners, moving.rounds.view(flat(ROUND)))
        joined = self._spheres[: len(faces) + len(rounds)]
        joined[face_count:] = np.concatenate([there[: sizes[0]], spheres[face_count:], there[sizes[0] :]])
        return {
            "faces": faces.view(flat(FACE)), "corners": corners, "rounds": rounds.view(flat(ROUND)), "spheres": joined
        }  # fmt: skip

    def _copy(self, fixed: Model, spheres: Float64, sizes: tuple[int, int, int]) -> None:
        held = self._room if self._fixed is fixed else (0, 0, 0)
        room = max(sizes[0], held[0]), max(sizes[1], held[1]), max(sizes[2], held[2])
        self._fixed, self._room = fixed, room
        self._faces: Records = join_parts([fixed.faces, np.zeros(room[0], FACE)])
        self._corners = np.concatenate([fixed.corners, np.zeros((room[1], 3))])
        self._rounds: Records = join_parts([fixed.rounds, np.zeros(room[2], ROUND)])
        self._spheres = np.concatenate([spheres, np.zeros((room[0] + room[2], spheres.shape[1]))])
        self._lit = np.zeros(0, np.int64)
