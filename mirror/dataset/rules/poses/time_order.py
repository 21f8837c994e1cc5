"""POS001."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "POS001",
    Severity.ERROR,
    remedy="`mirror ingest RECORDING... --replace`, or write the pose layer again, sorted by time",
)
def time_order(view: SceneView) -> Iterator[Finding]:
    """A pose is not later than the one before it."""
    poses = view.all_poses
    stamps = poses.integers("timestamp_ns")
    step = np.diff(stamps, prepend=stamps[:1])
    yield from poses.findings(
        poses.same_file & (step <= 0), lambda row: f"{step[row]} ns after the pose before it; expected more than 0"
    )
