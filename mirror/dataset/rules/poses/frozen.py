"""POS009."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.quaternions import angle_between_deg, quaternion_normalise

_LONGEST_S = 1.0
_MOVING_MPS = 3.0
_TURN_DEG = 5.0


@scene_rule(
    "POS009", Severity.WARNING, remedy="take the poses there from another source as a pose layer, or drop the pass"
)
def frozen(view: SceneView) -> Iterator[Finding]:
    """The position stands still for over a second, but the vehicle moves: it turns, or was too fast to stop at once."""
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
        fast = any(
            motion.speed_mps[step] > max(_MOVING_MPS, brake * motion.step_s[step])
            for step in (into, out)
            if poses.same_file[step]
        )
        bad[begin] = fast or _turn_deg(motion, begin, end) > _TURN_DEG
    length = np.zeros(len(poses))
    length[first] = (stamps[last] - stamps[first]) * 1e-9
    yield from poses.findings(
        bad, lambda row: f"the same position for {length[row]:.1f} s, while the vehicle turns or moves", worst=length
    )


def _turn_deg(motion: Motion, begin: int, end: int) -> float:
    """The angle between the first and the last orientation of a run of poses; 0 where it is not known."""
    # A course is made of positions: it says nothing of its own.
    if motion.poses.word("orientation", begin) != "recorded" or not (motion.unit[begin] and motion.unit[end]):
        return 0.0
    first, last = quaternion_normalise(motion.rotation[[begin, end]])
    return float(angle_between_deg(first, last))
