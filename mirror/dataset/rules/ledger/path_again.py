"""LED005."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_SHARE = 0.01
_LEAST_M = 0.1


@scene_rule(
    "LED005",
    Severity.WARNING,
    remedy="`mirror ingest RECORDING... --replace`; a drive in clips may count its path beyond the circle",
)
def path_again(view: SceneView) -> Iterator[Finding]:
    """The ledger's path is not the length of the recorded poses from entry to exit, by more than 1 %."""
    if view.dataset.document is None:
        return
    trigger = view.dataset.document.trigger
    poses = view.poses
    for file, number, rows in poses.slices():
        passed = view.traversals[number].passed
        stamps = poses.integers("timestamp_ns")[rows]
        entry, end = view.entry_ns[number], view.exit_ns[number]
        if passed is None or not view.sound_poses(rows) or not stamps[0] <= entry < end <= stamps[-1]:
            continue
        inside = np.flatnonzero((stamps > entry) & (stamps < end))
        at = (np.concatenate([[entry], stamps[inside], [end]]) - stamps[0]).astype(np.float64)
        seconds = (stamps - stamps[0]).astype(np.float64)
        x, y = (np.interp(at, seconds, poses.floats(name)[rows]) for name in ("tx_m", "ty_m"))
        sigma = np.nan_to_num(poses.floats("sigma_m")[rows], posinf=0.0)[inside]
        least = np.maximum(trigger.min_step_m, trigger.step_sigmas * np.concatenate([[0.0], sigma, [0.0]]))
        found, stated = counted_path(x, y, least), float(str(passed["path_m"]))
        if abs(found - stated) > max(_SHARE * max(found, stated), _LEAST_M):
            yield Finding(file, None, f"{found:.2f} m from entry to exit, but the ledger says {stated:.2f} m")


def counted_path(x: Float64, y: Float64, least: Float64) -> float:
    """Length of a line of points, where a point counts once it lies at least so far from the last one that counted.

    The last point always counts. All (N,), in metres.
    """
    steps = np.hypot(np.diff(x), np.diff(y))
    if (steps[:-1] >= least[1:-1]).all():
        return float(steps.sum())
    total, last_x, last_y = 0.0, x[0], y[0]
    for next_x, next_y, enough in zip(x[1:-1].tolist(), y[1:-1].tolist(), least[1:-1].tolist()):
        step = ((next_x - last_x) ** 2 + (next_y - last_y) ** 2) ** 0.5
        if step >= enough:
            total, last_x, last_y = total + step, next_x, next_y
    return float(total + np.hypot(x[-1] - last_x, y[-1] - last_y))
