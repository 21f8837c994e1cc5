"""POS011."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("POS011", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`")
def cover_pass(view: SceneView) -> Iterator[Finding]:
    """Poses do not reach from the entry to the exit of their pass."""
    first, last = view.pose_span()
    for number, item in enumerate(view.traversals):
        if item.passed is None or first[number] > last[number]:
            continue
        missing = max(int(first[number] - view.entry_ns[number]), int(view.exit_ns[number] - last[number]))
        if missing > 0:
            yield Finding(
                f"traversals/{item.traversal_id}/recorded/ego_poses.parquet",
                None,
                f"{missing * 1e-9:.3f} s of the pass have no poses: they run from {first[number]} to {last[number]},"
                f" the pass from {view.entry_ns[number]} to {view.exit_ns[number]}",
            )
