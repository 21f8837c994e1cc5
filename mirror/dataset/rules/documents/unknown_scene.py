"""DS010."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("DS010", Severity.ERROR, remedy="restore the scene in rois.geojson")
def unknown_scene(view: DatasetView) -> Iterator[Finding]:
    """A traversal is of a scene that is not in rois.geojson."""
    for traversal_id in view.named:
        scene_id = traversal_id.partition(".")[0]
        if view.scenes and scene_id not in view.scenes:
            yield Finding("rois.geojson", f"scene {scene_id}", f"missing, but traversal {traversal_id} is of it")
