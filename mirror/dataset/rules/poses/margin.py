"""POS012."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_MARGIN_NS = 1_000_000_000


@scene_rule("POS012", Severity.WARNING, remedy="`mirror ingest RECORDING... --replace`")
def margin(view: SceneView) -> Iterator[Finding]:
    """Poses end less than a second beyond an end of the pass, though the drive goes on there."""
    first, last = view.pose_span()
    for file, number, rows in view.poses.slices():
        item = view.traversals[number]
        own = view.poses.integers("timestamp_ns")[rows]
        if item.passed is None or len(own) < 2:
            continue
        # The next pose may just have missed the second.
        slack = int(np.diff(own).max())
        beyond = (
            ("entry", int(view.entry_ns[number] - first[number]), int(view.entry_ns[number]) - item.drive.start_ns),
            ("exit", int(last[number] - view.exit_ns[number]), item.drive.end_ns - int(view.exit_ns[number])),
        )
        for end, there, possible in beyond:
            if item.passed[f"{end}_kind"] == "crossing" and 0 <= there < min(_MARGIN_NS, possible) - slack:
                yield Finding(
                    file,
                    end,
                    f"poses reach {there * 1e-9:.3f} s beyond it, the drive {possible * 1e-9:.3f} s; expected 1 s",
                )
