"""POS009."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_LONGEST_S = 1.0
_MOVING_MPS = 3.0


@scene_rule(
    "POS009", Severity.WARNING, remedy="take the poses there from another source as a pose layer, or drop the pass"
)
def frozen(view: SceneView) -> Iterator[Finding]:
    """The position stands still for over a second at a speed from which nothing stops at once: a frozen receiver."""
    if view.dataset.document is None:
        return
    brake = view.dataset.document.cleaning.max_acceleration_mps2
    poses, motion = view.all_poses, view.motion
    stamps = poses.integers("timestamp_ns")
    still = poses.same_file & (motion.step_m == 0.0).all(axis=1)
    edges = np.diff(still.astype(np.int8), prepend=0, append=0)
    # A run of still steps begins behind its first pose and ends at its last.
    first, last = np.flatnonzero(edges == 1) - 1, np.flatnonzero(edges == -1) - 1
    long = (stamps[last] - stamps[first]) * 1e-9 > _LONGEST_S
    bad = np.zeros(len(poses), np.bool_)
    for begin, end in zip(first[long].tolist(), last[long].tolist()):
        into, out = begin, min(end + 1, len(poses) - 1)
        bad[begin] = any(
            motion.speed_mps[step] > max(_MOVING_MPS, brake * motion.step_s[step])
            for step in (into, out)
            if poses.same_file[step]
        )
    length = np.zeros(len(poses))
    length[first] = (stamps[last] - stamps[first]) * 1e-9
    yield from poses.findings(
        bad, lambda row: f"the same position for {length[row]:.1f} s, in motion before or after", worst=length
    )
