"""CAM003."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.cameras import COEFFICIENTS


@scene_rule(
    "CAM003",
    Severity.ERROR,
    remedy="correct the calibration in the recording, and `mirror ingest RECORDING... --replace`",
)
def no_camera(view: SceneView) -> Iterator[Finding]:
    """Intrinsics that make no camera: a focal length that is not positive, or a wrong number of coefficients."""
    calibrations = view.all_calibrations
    bad = np.zeros(len(calibrations), np.bool_)
    for row in view.camera_errors:
        # A model that nobody knows is an unknown word.
        bad[row] = calibrations.word("model", row) in COEFFICIENTS
    yield from calibrations.findings(bad, lambda row: str(view.camera_errors[row]))
