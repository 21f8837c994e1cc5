"""CAM005."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "CAM005", Severity.WARNING, remedy="calibrate with targets up to the corners; projections are invalid beyond"
)
def distortion_range(view: SceneView) -> Iterator[Finding]:
    """The distortion folds back within the picture: beyond that radius no pixel has a ray."""
    rows = view.all_calibrations
    reached = np.ones(len(rows))
    for row, camera in view.cameras.items():
        # From the principal point to the middles of the edges: a fisheye's dark corners are no fault.
        across = np.linspace(0.0, 1.0, 33)[:, None]
        centre = np.array([camera.cx_px, camera.cy_px])
        width, height = camera.width_px, camera.height_px
        ends = np.array([[0.0, centre[1]], [width, centre[1]], [centre[0], 0.0], [centre[0], height]])
        seen = camera.unproject(centre + across[:, None] * (ends - centre)).valid.all(axis=1)
        reached[row] = across[seen.argmin() - 1, 0] if not seen.all() else 1.0
    yield from rows.findings(
        reached < 1.0,
        lambda row: f"valid only up to {reached[row]:.0%} of the way from the principal point to an edge's middle",
        worst=-reached,
    )
