"""BOX002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "BOX002", Severity.ERROR, remedy="normalise the quaternions where they come from, and write the layer again"
)
def box_quaternion(view: SceneView) -> Iterator[Finding]:
    """A box's quaternion is not of unit length."""
    boxes = view.boxes
    placed = Motion(boxes)
    length = np.linalg.norm(placed.rotation, axis=1)
    yield from boxes.findings(
        ~placed.unit & np.isfinite(length),
        lambda row: f"length {length[row]:.9g}; expected 1",
        worst=np.abs(length - 1.0),
    )
