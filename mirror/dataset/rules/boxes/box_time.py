"""BOX007."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("BOX007", Severity.ERROR, remedy="write the layer again without the boxes outside the pass")
def box_time(view: SceneView) -> Iterator[Finding]:
    """A box lies before the first or behind the last pose of its traversal: it has no place in the world."""
    first, last = view.pose_span()
    boxes = view.boxes
    stamps, number = boxes.integers("timestamp_ns"), boxes.traversal
    has_poses = (first <= last)[number]
    yield from boxes.findings(
        has_poses & ((stamps < first[number]) | (stamps > last[number])),
        lambda row: f"outside the poses, {first[number[row]]} to {last[number[row]]}",
    )
