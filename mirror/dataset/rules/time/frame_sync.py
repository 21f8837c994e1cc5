"""TIM003."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "TIM003", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`: its frames were put together wrongly"
)
def frame_sync(view: SceneView) -> Iterator[Finding]:
    """A picture is more than half a period away from the reference exposure of its frame."""
    images = view.images
    frames = view.frames
    off_s = np.abs(images.integers("timestamp_ns") - frames.reference_ns) * 1e-9
    limit_s = 0.5 * frames.period_s[images.traversal]
    yield from images.findings(
        frames.framed & (off_s > limit_s + 1e-9),
        lambda row: (
            f"{off_s[row] * 1e3:.3f} ms from frame {images.integers('frame_index')[row]};"
            f" expected at most {limit_s[row] * 1e3:.3f} ms"
        ),
        worst=np.where(frames.framed, off_s, 0.0),
    )
