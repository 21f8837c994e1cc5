"""Depth of trained models, and heights of their ground, against exact truth."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
import torch

from benchmarks.studies.static_reconstruction.truth.street import TrueView, world_points
from benchmarks.studies.static_reconstruction.truth.trained import TrainedModel
from hybridworldsim.methods.street import StreetRenderer
from mirror.arrays import Bool, Float64
from mirror.protocols.views.view import RenderView
from mirror.synth.model import Label

EDGES_M: Final = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0)
GROUND_M: Final = 25.0
"""Ground is measured within this distance of a camera."""
_OPAQUE: Final = 0.5


def measure_geometry(trained: TrainedModel) -> dict[str, Any]:
    """Return the errors of depth and of the ground's height, on views of training and of held-out traversals."""
    renderer, street = trained.open(), trained.street
    depth, ground = [], []
    for group in [one.name for one in trained.plan.protocol.groups]:
        relative, true, heights = [], [], []
        for view in trained.views(group):
            truth, scored = street.true_view(view), street.recorded.scored_mask(view)
            shown = renderer.render(view).depth_m.numpy().astype(np.float64)
            chosen = truth.static & scored
            true.append(truth.depth_m[chosen].astype(np.float64))
            relative.append(relative_error(shown[chosen], true[-1]))
            points = world_points(shown, view)[nearby_road(truth, view) & scored]
            heights.append(points[:, 2] - street.height_m(view, points))
        rows = by_distance(np.concatenate(relative), np.concatenate(true))
        depth += [{"group": group, **row} for row in rows]
        ground.append({"surface": f"as drawn, {group}", **height_errors(np.concatenate(heights))})
    # Where there are no anchors, the background is of the ground's kind.
    if isinstance(renderer, StreetRenderer) and trained.entry.settings(trained.job.seed)["hybrid"]:
        ground.append({"surface": "Gaussians of the ground", **height_errors(_ground_node_errors(trained, renderer))})
    return {"depth": depth, "ground": ground}


def relative_error(depth_m: Float64, true_m: Float64) -> Float64:
    """Return ``|depth - true| / true`` (N,)."""
    return np.abs(depth_m - true_m) / true_m


def by_distance(errors: Float64, true_m: Float64, edges_m: Sequence[float] = EDGES_M) -> list[dict[str, float]]:
    """Compute the median and 90th percentile of errors (N,) for each range of true depths (N,).

    A range is from an edge to below the next.

    A range without a pixel has NaN.
    """
    rows = []
    for low, high in pairwise(edges_m):
        own = errors[(true_m >= low) & (true_m < high)]
        middle, most = np.quantile(own, (0.5, 0.9)) if len(own) else (np.nan, np.nan)
        rows.append({"from_m": low, "to_m": high, "median": float(middle), "p90": float(most), "pixels": len(own)})
    return rows


def height_errors(errors_m: Float64) -> dict[str, float]:
    """Return the median of signed errors (N,), median and 90th percentile of their magnitudes; NaN without errors."""
    if not len(errors_m):
        return {"bias_m": np.nan, "median_m": np.nan, "p90_m": np.nan, "count": 0}
    middle, most = np.quantile(np.abs(errors_m), (0.5, 0.9))
    return {
        "bias_m": float(np.median(errors_m)), "median_m": float(middle), "p90_m": float(most), "count": len(errors_m)
    }  # fmt: skip


def nearby_road(truth: TrueView, view: RenderView) -> Bool:
    """Mark the pixels (H, W) that show road within `GROUND_M` of the camera."""
    points = world_points(np.where(truth.static, truth.depth_m, 0.0), view)
    away = np.linalg.norm(points - view.pose.translation[0], axis=-1)
    return (truth.label == Label.ROAD) & truth.static & (away <= GROUND_M)


def _ground_node_errors(trained: TrainedModel, street: StreetRenderer) -> Float64:
    """Signed errors of the ground's opaque Gaussians near training cameras."""
    from scipy.spatial import cKDTree

    views = trained.views("training")
    cameras = cKDTree(np.concatenate([view.pose.translation[:, :2] for view in views]))
    found = []
    for block, model in street.blocks:
        with torch.no_grad():
            opaque = model.ground.logits.sigmoid() >= _OPAQUE
            means = model.ground.means[opaque].numpy().astype(np.float64) + np.array(block.origin_m)
        near = means[cameras.query(means[:, :2])[0] <= GROUND_M]
        found.append(near[:, 2] - trained.street.height_m(views[0], near))
    return np.concatenate(found)
