"""POS005."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "POS005", Severity.WARNING, remedy="take the poses between from another source as a pose layer, or drop the pass"
)
def gap(view: SceneView) -> Iterator[Finding]:
    """Poses are missing within a pass, for longer than the trigger's `max_gap_s`, while the vehicle moved."""
    if view.dataset.document is None:
        return
    trigger = view.dataset.document.trigger
    poses, motion = view.all_poses, view.motion
    stamps = poses.integers("timestamp_ns")
    inside = (stamps > view.entry_ns[poses.traversal]) & (np.roll(stamps, 1) < view.exit_ns[poses.traversal])
    bad = inside & (motion.step_s > trigger.max_gap_s) & (motion.distance_m > trigger.min_step_m)
    yield from poses.findings(
        bad,
        lambda row: (
            f"{motion.step_s[row]:.3f} s and {motion.distance_m[row]:.1f} m after the pose before it;"
            f" expected at most {trigger.max_gap_s:g} s"
        ),
        worst=motion.step_s,
    )
