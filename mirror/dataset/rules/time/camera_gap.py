"""TIM005."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_PERIODS = 1.5


@scene_rule("TIM005", Severity.WARNING, remedy="look for dropped pictures in the recording; loaders leave them out")
def camera_gap(view: SceneView) -> Iterator[Finding]:
    """A camera pauses: two of its pictures are more than one and a half of its periods apart."""
    images = view.images
    stamps = images.integers("timestamp_ns")
    step_s = np.full(len(images), np.nan)
    period_s = np.full(len(images), np.nan)
    for start, stop in pairwise(images.runs("camera").tolist()):
        if stop - start > 2:
            step_s[start + 1 : stop] = np.diff(stamps[start:stop]) * 1e-9
            period_s[start:stop] = np.median(step_s[start + 1 : stop])
    yield from images.findings(
        step_s > _PERIODS * period_s,
        lambda row: (
            f"{step_s[row] * 1e3:.1f} ms after the camera's picture before it; its period is"
            f" {period_s[row] * 1e3:.1f} ms"
        ),
        worst=step_s,
    )
