"""LED004."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule

_ON_THE_CIRCLE_M = 1e-3


@dataset_rule(
    "LED004",
    Severity.ERROR,
    remedy="`mirror ingest RECORDING... --replace`, or restore the scene's circle in rois.geojson",
)
def never_inside(view: DatasetView) -> Iterator[Finding]:
    """A pass never comes within its scene's radius."""
    passes = view.passes
    codes, words = passes.words("scene_id")
    radius = np.array([view.scenes[word].radius_m if word in view.scenes else np.inf for word in words])[codes]
    closest = passes.floats("closest_m")
    yield from passes.findings(
        closest > radius + _ON_THE_CIRCLE_M,
        lambda row: f"closest to the centre at {closest[row]:.3f} m; expected at most {radius[row]:g} m",
        worst=closest,
    )
