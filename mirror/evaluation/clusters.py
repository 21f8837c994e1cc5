"""Means of the figure that ranks in each cluster: what ranks with intervals are computed from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from mirror.evaluation.figures import mean_weights, overall_averaging
from mirror.evaluation.result import ClusterMean
from mirror.protocols.document import Protocol
from mirror.protocols.ranking import ALL
from mirror.protocols.views.view import RenderView

_KEYS: Final = ("group", "scene_id", "traversal_id")


def compute_clusters(protocol: Protocol, rows: Sequence[Mapping[str, Any]]) -> tuple[ClusterMean, ...]:
    """Compute the means of the ranking figure in each scene, or for rollouts in each scenario of a scene.

    Args:
        protocol: the protocol, with its ranking key and its averaging.
        rows: rows of the table of images or of rollouts, with ``group``, ``scene_id``, ``traversal_id`` (of a rollout:
            its scenario) and figures by name. Figures that are not finite are left out.

    Returns:
        The clusters, sorted by key; none if no figure ranks, or one of a whole set of images does.
    """
    ranking = protocol.ranking
    if ranking is None:
        return ()
    members = [row for row in rows if row["group"] in ranking.groups and _is_finite(row.get(ranking.metric))]
    if not members:
        return ()
    views = [RenderView.model_construct(**{key: row[key] for key in _KEYS}) for row in members]
    weights = mean_weights(views, overall_averaging(protocol) if ranking.group == ALL else protocol.averaging)
    values = np.array([row[ranking.metric] for row in members])
    places: dict[str, list[int]] = {}
    for place, view in enumerate(views):
        is_rollout = protocol.task == "safety"
        key = f"{view.scene_id}, {view.traversal_id}" if is_rollout else view.scene_id
        places.setdefault(key, []).append(place)
    clusters = []
    for key in sorted(places):
        chosen = places[key]
        weight = math.fsum(weights[chosen])
        mean = math.fsum(weights[chosen] * values[chosen]) / weight
        clusters.append(ClusterMean(key=key, value=mean, weight=weight, n=len(chosen)))
    return tuple(clusters)


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)
