"""DS002."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("DS002", Severity.ERROR, remedy="restore rois.geojson")
def regions(view: DatasetView) -> Iterator[Finding]:
    """rois.geojson is missing or broken, or a scene is in it twice."""
    if not view.scenes:
        yield from unread(view.problems, lambda file: file == "rois.geojson")
