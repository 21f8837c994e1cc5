"""Driven lines of traversals, and the distances between them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from hybridworldsim.trainable.viewpoint import Source
from hybridworldsim.training.documents import TrainedCamera
from mirror.arrays import Float64
from mirror.protocols.views.view import RenderView

_STEP_M: Final = 0.5


class DrivenLines:
    """The driven lines of a street's training traversals and of requested views.

    Lines are densified and indexed once, and two lines are compared once, however many blocks of the street need it.

    Args:
        known: trained traversals and cameras of the street.
        views: all views to render; their positions form the lines of their traversals.
    """

    def __init__(self, known: Sequence[TrainedCamera], views: Sequence[RenderView]) -> None:
        self.known = tuple(known)
        self._views = views
        self._trees: dict[str, cKDTree] | None = None
        self._view_trees: dict[str, cKDTree] | None = None
        self._distances_m: dict[tuple[str, str], float] = {}

    def nearest(self, view: RenderView, names: Sequence[str]) -> str:
        """Return the name of the trained traversal whose line is nearest to the line of a view's traversal.

        A traversal that is not among the requested views is compared by the position of the one view.
        """
        if self._view_trees is None:
            by_camera: dict[Source, list[Float64]] = {}
            for viewed in self._views:
                by_camera.setdefault(Source(viewed.traversal_id, viewed.camera), []).append(viewed.pose.translation[0])
            self._view_trees = _trees((source.traversal_id, places) for source, places in by_camera.items())
        view_line = self._view_trees.get(view.traversal_id)
        if view_line is None:
            camera = cKDTree(view.pose.translation)
            return min(names, key=lambda name: _chamfer_m(camera, self._line(name)))

        def distance_m(name: str) -> float:
            key = (view.traversal_id, name)
            if key not in self._distances_m:
                self._distances_m[key] = _chamfer_m(view_line, self._line(name))
            return self._distances_m[key]

        return min(names, key=distance_m)

    def _line(self, name: str) -> cKDTree:
        if self._trees is None:
            self._trees = _trees((source.traversal_id, source.centre_m) for source in self.known)
        return self._trees[name]


def chamfer_m(ours: Float64, theirs: Float64) -> float:
    """Return the sum of the mean distances from each of two sets of places to the nearest place of the other."""
    return _chamfer_m(cKDTree(ours), cKDTree(theirs))


def _chamfer_m(ours: cKDTree, theirs: cKDTree) -> float:
    return float(theirs.query(ours.data)[0].mean() + ours.query(theirs.data)[0].mean())


def _trees(driven: Iterable[tuple[str, Sequence[Sequence[float] | Float64]]]) -> dict[str, cKDTree]:
    """A search tree of the line of each traversal, over all its cameras."""
    lines: dict[str, list[Float64]] = {}
    for name, places in driven:
        lines.setdefault(name, []).append(densify_line(np.array(places)))
    return {name: cKDTree(np.concatenate(own)) for name, own in lines.items()}


def densify_line(places: Float64) -> Float64:
    """Insert places into a line (N, 3), so that consecutive places are at most half a metre apart."""
    steps = np.diff(places, axis=0)
    counts = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) / _STEP_M), 1.0).astype(np.int64)
    ends = np.repeat(counts.cumsum(), counts)
    shares = 1.0 - (ends - 1.0 - np.arange(counts.sum())) / np.repeat(counts, counts)
    between = np.repeat(places[:-1], counts, axis=0) + shares[:, None] * np.repeat(steps, counts, axis=0)
    return np.concatenate([places[:1], between])
