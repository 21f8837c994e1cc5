"""TIM008."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.schema.documents import DriveDocument


@dataset_rule(
    "TIM008", Severity.WARNING, remedy="remove one of two recordings of the same drive, or correct the vehicle's id"
)
def one_vehicle(view: DatasetView) -> Iterator[Finding]:
    """Two drives of one vehicle overlap in time: it cannot be in two places."""
    by_vehicle: dict[str, list[tuple[int, str, DriveDocument]]] = defaultdict(list)
    for name, drive in view.drives.items():
        by_vehicle[drive.vehicle_id].append((drive.start_ns, name, drive))
    for vehicle_id, own in by_vehicle.items():
        own.sort(key=lambda item: item[:2])
        longest = own[0]
        for start_ns, name, drive in own[1:]:
            overlap_s = (min(longest[2].end_ns, drive.end_ns) - start_ns) * 1e-9
            if overlap_s > 0:
                yield Finding(
                    f"drives/{name}/drive.json",
                    "start_ns",
                    f"vehicle {vehicle_id} is in drive {longest[1]} at the same time, for {overlap_s:.1f} s",
                )
            if drive.end_ns > longest[2].end_ns:
                longest = (start_ns, name, drive)
