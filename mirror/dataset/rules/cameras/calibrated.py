"""CAM001."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_MIN, _MAX = np.iinfo(np.int64).min, np.iinfo(np.int64).max


@scene_rule(
    "CAM001",
    Severity.ERROR,
    remedy="give the recording a calibration of that camera for that time, `mirror ingest RECORDING... --replace`",
)
def calibrated(view: SceneView) -> Iterator[Finding]:
    """No calibration of a camera, of any stage, is valid when one of its pictures was taken."""
    images, calibrations = view.images, view.calibrations
    # Where the table of calibrations cannot be read, another rule says so.
    bad = np.isin(images.traversal, [number for _, number, _ in calibrations.parts])
    start = np.where(calibrations.known("valid_from_ns"), calibrations.integers("valid_from_ns"), _MIN)
    end = np.where(calibrations.known("valid_to_ns"), calibrations.integers("valid_to_ns"), _MAX)
    stamps = images.integers("timestamp_ns")
    for row, own, same_camera in view.calibrated_pictures():
        bad[own] &= ~(same_camera & (stamps[own] >= start[row]) & (stamps[own] <= end[row]))
    yield from images.findings(bad, lambda row: "no calibration of the camera is valid at this time")
