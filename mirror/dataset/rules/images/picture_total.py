"""IMG011."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("IMG011", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`")
def picture_total(view: SceneView) -> Iterator[Finding]:
    """A traversal's manifest states another number or size of pictures than its images table."""
    length = view.images.integers("byte_length")
    for file, number, rows in view.images.slices():
        stated = view.dataset.recorded_manifests[view.traversals[number].traversal_id].pictures
        count, total = rows.stop - rows.start, int(length[rows].sum())
        if (stated.count, stated.bytes) != (count, total) if stated is not None else count > 0:
            says = f"{stated.count} pictures of {stated.bytes} bytes" if stated is not None else "nothing of pictures"
            yield Finding(file, None, f"{count} pictures of {total} bytes, but the manifest says {says}")
