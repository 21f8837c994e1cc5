"""GEO004."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_LIMIT_DEG = 30.0


@scene_rule("GEO004", Severity.WARNING, remedy="check the source's body frame and angles: x forward, y left, z up")
def tilt(view: SceneView) -> Iterator[Finding]:
    """The vehicle is tilted by more than 30 degrees: no street is that steep."""
    motion = view.motion
    angle = np.degrees(np.arccos(np.clip(motion.up(), -1.0, 1.0)))
    yield from view.all_poses.findings(
        motion.unit & (angle > _LIMIT_DEG), lambda row: f"tilted by {angle[row]:.1f} degrees", worst=angle
    )
