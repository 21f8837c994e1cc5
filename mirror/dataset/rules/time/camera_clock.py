"""TIM002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "TIM002", Severity.ERROR, remedy="correct the stamps in the recording, and `mirror ingest RECORDING... --replace`"
)
def camera_clock(view: SceneView) -> Iterator[Finding]:
    """A camera's exposures do not follow each other: one starts or ends before the one of an earlier picture."""
    images = view.images
    same = images.same_group("camera")
    stamps = images.integers("timestamp_ns")
    back = np.zeros(len(images), np.bool_)
    for name in ("exposure_start_ns", "exposure_end_ns"):
        values = images.integers(name)
        back[1:] |= (values[1:] < values[:-1]) & (stamps[1:] > stamps[:-1])
    yield from images.findings(
        same & back,
        lambda row: (
            f"exposure from {images.integers('exposure_start_ns')[row]} to"
            f" {images.integers('exposure_end_ns')[row]}, that of the picture before it from"
            f" {images.integers('exposure_start_ns')[row - 1]} to {images.integers('exposure_end_ns')[row - 1]}"
        ),
    )
