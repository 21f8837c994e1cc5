"""GEO003."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_MOVING_MPS = 2.0
_LIMIT_DEG = 45.0


@scene_rule("GEO003", Severity.WARNING, remedy="check the source's body frame: x forward, y left, z up")
def heading(view: SceneView) -> Iterator[Finding]:
    """For most of its way the vehicle does not drive where it looks: a body frame or heading with another meaning."""
    poses, motion = view.all_poses, view.motion
    forward = motion.forward()
    along = (forward * motion.step_m[:, :2]).sum(axis=1)
    across = forward[:, 0] * motion.step_m[:, 1] - forward[:, 1] * motion.step_m[:, 0]
    angle = np.degrees(np.arctan2(across, along))
    # A heading that was taken from the course says nothing about the source's.
    codes, words = poses.words("orientation")
    recorded = codes != (words.index("course") if "course" in words else len(words))
    moving = recorded & (motion.speed_mps > _MOVING_MPS) & np.isfinite(angle)
    way = np.where(moving, motion.distance_m, 0.0)
    wrong = np.where(moving & (np.abs(angle) > _LIMIT_DEG), motion.distance_m, 0.0)
    total = np.bincount(poses.owner, way, minlength=len(poses.files))
    astray = np.bincount(poses.owner, wrong, minlength=len(poses.files))
    for owner in np.flatnonzero(astray > 0.5 * total).tolist():
        own = angle[(poses.owner == owner) & moving]
        yield Finding(
            poses.files[owner],
            None,
            f"on {astray[owner]:.0f} of {total[owner]:.0f} m the heading is over {_LIMIT_DEG:g} degrees off the course"
            f" (median {np.median(own):+.0f} degrees, left positive)",
        )
