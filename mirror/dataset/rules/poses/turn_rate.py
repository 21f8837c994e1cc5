"""POS008."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.quaternions import angle_between_deg, quaternion_normalise

_SPAN_S = 0.2
_LIMIT_DEGPS = 120.0


@scene_rule(
    "POS008", Severity.WARNING, remedy="look for a jump of the orientation there, and correct it in a pose layer"
)
def turn_rate(view: SceneView) -> Iterator[Finding]:
    """The recorded orientation jumps: over a fifth of a second, faster than 120 degrees a second."""
    poses = view.all_poses
    codes, words = poses.words("orientation")
    recorded = codes == (words.index("recorded") if "recorded" in words else -2)
    rate = turn_rates(view.motion)
    yield from poses.findings(
        recorded & (rate > _LIMIT_DEGPS),
        lambda row: f"{rate[row]:.0f} degrees a second; expected at most {_LIMIT_DEGPS:g}",
        worst=rate,
    )


def turn_rates(motion: Motion) -> Float64:
    """Turn rate (N,) in degrees a second towards the pose a fifth of a second later, or the next if that is later."""
    poses = motion.poses
    stamps = poses.integers("timestamp_ns")
    result = np.full(len(poses), np.nan)
    for start, stop in zip(poses.starts[:-1].tolist(), poses.starts[1:].tolist()):
        if stop - start < 2 or not (motion.step_s[start + 1 : stop] > 0).all() or not motion.unit[start:stop].all():
            continue
        seconds = (stamps[start:stop] - stamps[start]) * 1e-9
        later = np.searchsorted(seconds, seconds + _SPAN_S - 1e-9)
        here = np.flatnonzero(later < stop - start)
        rotation = quaternion_normalise(motion.rotation[start:stop])
        angle = angle_between_deg(rotation[here], rotation[later[here]])
        result[start + here] = angle / (seconds[later[here]] - seconds[here])
    return result
