"""GEO005."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.splits.leaks import overlapping_scenes as overlapping


@dataset_rule("GEO005", Severity.INFO, remedy="nothing to do: a split by scene keeps them in one role")
def overlapping_scenes(view: DatasetView) -> Iterator[Finding]:
    """Two scenes overlap: their circles are closer than the sum of their radii."""
    for first, second, distance in overlapping(view.scenes.values()):
        yield Finding(
            "rois.geojson",
            f"scenes {first.scene_id} and {second.scene_id}",
            f"{distance:.1f} m apart with radii of {first.radius_m:g} m and {second.radius_m:g} m",
        )
