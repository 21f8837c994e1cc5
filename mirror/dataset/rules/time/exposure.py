"""TIM001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "TIM001", Severity.ERROR, remedy="correct the stamps in the recording, and `mirror ingest RECORDING... --replace`"
)
def exposure(view: SceneView) -> Iterator[Finding]:
    """A picture's stamp is not within its exposure, or the exposure ends before it starts."""
    images = view.all_images
    start, middle, end = (images.integers(name) for name in ("exposure_start_ns", "timestamp_ns", "exposure_end_ns"))
    yield from images.findings(
        (start > middle) | (middle > end),
        lambda row: f"exposure from {start[row]} to {end[row]}; expected start <= timestamp_ns <= end",
    )
