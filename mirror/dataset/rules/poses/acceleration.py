"""POS007."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_SPAN_S = 0.5


@scene_rule("POS007", Severity.WARNING, remedy="smooth the track into a pose layer, or look for a jump of the fix")
def acceleration(view: SceneView) -> Iterator[Finding]:
    """The velocity jumps: over half a second, more than cleaning's `max_acceleration_mps2` on the level."""
    if view.dataset.document is None:
        return
    limit = view.dataset.document.cleaning.max_acceleration_mps2
    found = accelerations(view.motion)
    yield from view.all_poses.findings(
        found > limit, lambda row: f"{found[row]:.1f} m/s2; expected at most {limit:g} m/s2", worst=found
    )


def accelerations(motion: Motion) -> Float64:
    """Second difference (N,) of the horizontal position over half a second to both sides, or a step if that is longer.

    A tenth of a second would turn centimetres of noise into many m/s2. NaN near the ends of a file.
    """
    poses = motion.poses
    stamps = poses.integers("timestamp_ns")
    before = motion.step_s
    after = np.append(before[1:], np.nan)
    span = np.fmax(_SPAN_S, np.fmax(before, after))
    result = np.full(len(poses), np.nan)
    for start, stop in zip(poses.starts[:-1].tolist(), poses.starts[1:].tolist()):
        own = slice(start, stop)
        if stop - start < 3 or not (before[start + 1 : stop] > 0).all():
            continue
        seconds = (stamps[own] - stamps[start]) * 1e-9
        early, late = seconds - span[own], seconds + span[own]
        whole = (early >= 0) & (late <= seconds[-1])
        total = np.zeros(stop - start)
        for axis in (0, 1):
            at = motion.position[own, axis]
            bend = np.interp(early, seconds, at) + np.interp(late, seconds, at) - 2.0 * at
            total += (bend / span[own] ** 2) ** 2
        result[own] = np.where(whole, np.sqrt(total), np.nan)
    return result
