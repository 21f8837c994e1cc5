"""CAM002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "CAM002",
    Severity.ERROR,
    remedy="scale the calibration to the stored raster, and `mirror ingest RECORDING... --replace`",
)
def raster(view: SceneView) -> Iterator[Finding]:
    """A picture is of another size than its camera is calibrated for."""
    images, calibrations = view.images, view.calibrations
    width, height = images.integers("width_px"), images.integers("height_px")
    across, down = calibrations.integers("width_px"), calibrations.integers("height_px")
    calibrated = np.full(len(images), -1, np.int64)
    for row, own, same_camera in view.calibrated_pictures():
        other = same_camera & ((width[own] != across[row]) | (height[own] != down[row]))
        calibrated[own] = np.where(other, row, calibrated[own])
    yield from images.findings(
        calibrated >= 0,
        lambda row: (
            f"{width[row]} x {height[row]} px, but calibrated"
            f" ({calibrations.word('stage', int(calibrated[row]))}) for"
            f" {across[calibrated[row]]} x {down[calibrated[row]]} px"
        ),
    )
