"""GEO002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_JUMP_M = 2.0
_GRADE = 0.35


@scene_rule("GEO002", Severity.WARNING, remedy="smooth the height into a pose layer, or look for a change of geoid")
def height_jump(view: SceneView) -> Iterator[Finding]:
    """The height jumps: from one pose to the next by over 2 m more than the steepest street climbs."""
    motion = view.motion
    climb = np.abs(motion.step_m[:, 2])
    yield from view.all_poses.findings(
        climb > _JUMP_M + _GRADE * motion.distance_m,
        lambda row: f"{motion.step_m[row, 2]:+.2f} m over {motion.distance_m[row]:.2f} m of way",
        worst=climb,
    )
