"""DS011."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule(
    "DS011",
    Severity.WARNING,
    remedy="give the vehicles different ids, or correct the type, and `mirror ingest RECORDING... --replace`",
)
def vehicle(view: DatasetView) -> Iterator[Finding]:
    """One vehicle has several vehicle types."""
    types: dict[str, dict[str, str]] = defaultdict(dict)
    for name, drive in view.drives.items():
        types[drive.vehicle_id].setdefault(drive.vehicle_type, name)
    for vehicle_id, own in types.items():
        if len(own) > 1:
            listed = ", ".join(f"{kind!r} in drive {name}" for kind, name in own.items())
            yield Finding(
                f"drives/{list(own.values())[1]}/drive.json", "vehicle_type", f"vehicle {vehicle_id}: {listed}"
            )
