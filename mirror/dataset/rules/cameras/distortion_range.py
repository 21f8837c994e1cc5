"""CAM005."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.cameras import Camera


@scene_rule(
    "CAM005", Severity.WARNING, remedy="calibrate with targets up to the corners; projections are invalid beyond"
)
def distortion_range(view: SceneView) -> Iterator[Finding]:
    """The distortion folds back within the picture: beyond that radius no pixel has a ray."""
    rows = view.all_calibrations
    share = {camera: _valid_share(camera) for camera in set(view.cameras.values())}
    reached = np.ones(len(rows))
    for row, camera in view.cameras.items():
        reached[row] = share[camera]
    yield from rows.findings(
        reached < 1.0,
        lambda row: f"valid only up to {reached[row]:.0%} of the way from the principal point to an edge's middle",
        worst=-reached,
    )


def _valid_share(camera: Camera) -> float:
    """How far the ways from the principal point to the middles of the edges have rays.

    Not to the corners: those of a fisheye are dark.
    """
    across = np.linspace(0.0, 1.0, 33)[:, None, None]
    x, y = camera.cx_px, camera.cy_px
    ends = np.array([[0.0, y], [camera.width_px, y], [x, 0.0], [x, camera.height_px]])
    seen = camera.unproject((x, y) + across * (ends - (x, y))).valid.all(axis=1)
    return 1.0 if seen.all() else float(across[max(int(np.argmin(seen)) - 1, 0), 0, 0])
