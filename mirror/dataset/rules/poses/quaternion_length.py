"""POS003."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "POS003", Severity.ERROR, remedy="normalise the quaternions where they come from, and write the table again"
)
def quaternion_length(view: SceneView) -> Iterator[Finding]:
    """A pose's quaternion is not of unit length."""
    motion = view.motion
    length = np.linalg.norm(motion.rotation, axis=1)
    bad = ~motion.unit & np.isfinite(length)
    yield from view.all_poses.findings(
        bad, lambda row: f"length {length[row]:.9g}; expected 1", worst=np.abs(length - 1.0)
    )
