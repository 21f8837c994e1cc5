"""PTS001."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("PTS001", Severity.ERROR, remedy="write the layer of points again")
def point_numbers(view: SceneView) -> Iterator[Finding]:
    """A point has a coordinate that is not finite, a negative number of views, or a sigma that is not positive."""
    rows = view.points
    place = np.stack([rows.floats(name) for name in ("x_m", "y_m", "z_m")], axis=1)
    sigma = rows.floats("sigma_m")
    bad = ~np.isfinite(place).all(axis=1) | (rows.integers("views") < 0)
    bad |= rows.known("sigma_m") & ~((sigma > 0.0) & np.isfinite(sigma))
    yield from rows.findings(
        bad, lambda row: f"at {place[row].tolist()}, views {rows.integers('views')[row]}, sigma_m {sigma[row]}"
    )
