"""CAM006."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "CAM006",
    Severity.ERROR,
    remedy="correct the calibration in the recording, and `mirror ingest RECORDING... --replace`",
)
def mounting(view: SceneView) -> Iterator[Finding]:
    """A camera's mounting is no pose: a number is not finite, or the quaternion is not of unit length."""
    mounted = Motion(view.all_calibrations)
    bad = ~(mounted.unit & np.isfinite(mounted.position).all(axis=1))
    yield from view.all_calibrations.findings(
        bad,
        lambda row: f"quaternion {mounted.rotation[row].tolist()}, translation {mounted.position[row].tolist()}",
    )
