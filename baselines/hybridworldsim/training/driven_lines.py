"""Lines that were driven, and how near one is to another."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from hybridworldsim.training.run.folder import TrainedCamera
from hybridworldsim.training.viewpoint import Source
from mirror.arrays import Float64
from mirror.protocols.views.view import RenderView

_STEP_M: Final = 0.5


class DrivenLines:
    """The lines of a street that were trained on, and those that are asked for.

    A line is filled up and sorted into a tree once, and two are compared once, however many blocks of the street ask.

    Args:
        known: what the street was trained on.
        views: all that will be rendered: what they tell of a traversal's line decides which is nearest to it.
    """

    def __init__(self, known: Sequence[TrainedCamera], views: Sequence[RenderView]) -> None:
        self.known = tuple(known)
        self._views = views
        self._trees: dict[str, cKDTree] | None = None
        self._asked: dict[str, cKDTree] | None = None
        self._apart_m: dict[tuple[str, str], float] = {}

    def nearest(self, view: RenderView, names: Sequence[str]) -> str:
        """Of traversals that were trained on, the one whose line is nearest to that of a view's traversal.

        A traversal that is not among what is asked for is judged by the one view.
        """
        if self._asked is None:
            by_camera: dict[Source, list[Float64]] = {}
            for one in self._views:
                by_camera.setdefault(Source(one.traversal_id, one.camera), []).append(one.pose.translation[0])
            self._asked = _trees((source.traversal_id, places) for source, places in by_camera.items())
        line = self._asked.get(view.traversal_id)
        if line is None:
            alone = cKDTree(view.pose.translation)
            return min(names, key=lambda name: _apart_m(alone, self._line(name)))

        def apart_m(name: str) -> float:
            key = (view.traversal_id, name)
            if key not in self._apart_m:
                self._apart_m[key] = _apart_m(line, self._line(name))
            return self._apart_m[key]

        return min(names, key=apart_m)

    def _line(self, name: str) -> cKDTree:
        if self._trees is None:
            self._trees = _trees((one.traversal_id, one.centre_m) for one in self.known)
        return self._trees[name]


def chamfer_m(ours: Float64, theirs: Float64) -> float:
    """Mean distance of two sets of places (N, 3), (M, 3) to the nearest of the other, there and back."""
    return _apart_m(cKDTree(ours), cKDTree(theirs))


def _apart_m(ours: cKDTree, theirs: cKDTree) -> float:
    return float(theirs.query(ours.data)[0].mean() + ours.query(theirs.data)[0].mean())


def _trees(driven: Iterable[tuple[str, Sequence[Sequence[float] | Float64]]]) -> dict[str, cKDTree]:
    """Of each traversal that which its cameras drove."""
    lines: dict[str, list[Float64]] = {}
    for name, places in driven:
        lines.setdefault(name, []).append(densify_line(np.array(places)))
    return {name: cKDTree(np.concatenate(own)) for name, own in lines.items()}


def densify_line(places: Float64) -> Float64:
    """Places (N, 3) of a line, with others between them: neighbours are half a metre apart at most."""
    steps = np.diff(places, axis=0)
    counts = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) / _STEP_M), 1.0).astype(np.int64)
    ends = np.repeat(counts.cumsum(), counts)
    shares = 1.0 - (ends - 1.0 - np.arange(counts.sum())) / np.repeat(counts, counts)
    between = np.repeat(places[:-1], counts, axis=0) + shares[:, None] * np.repeat(steps, counts, axis=0)
    return np.concatenate([places[:1], between])
