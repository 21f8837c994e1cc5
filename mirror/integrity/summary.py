"""A summary of a dataset. It needs no index; it reports whether an index is current."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mirror.dataset.index.build import find_changes
from mirror.dataset.index.table_copy import local_tables
from mirror.errors import MirrorError
from mirror.integrity.dataset_view import DatasetView
from mirror.schema.documents import DatasetDocument
from mirror.schema.tables import LIDARS

_JSON_KEYS: Final = {"images": "pictures", "image_bytes": "picture_bytes"}
"""Keys of ``mirror info --json`` that differ from the field; they stay for those who read them."""


@dataclass(frozen=True)
class DatasetSummary:
    """Counts and states of a dataset.

    Attributes:
        document: ``dataset.json``.
        scenes: traversals by scene.
        drives: number of complete drives.
        vehicles: drives by vehicle.
        vehicle_types: drives by vehicle type.
        rigs: camera names by rig.
        traversals: number of traversals.
        images: number of recorded images.
        image_bytes: their total size.
        first_ns: the earliest entry; None: no traversal.
        last_ns: the latest exit.
        hours: sum of the traversals' durations.
        passes: passes by decision: ``accepted``, or the rule that refused them.
        layers: traversals by layer, ``kind/source@version``.
        sweeps: number of lidar sweeps that are referred to.
        road_maps: number of lanes of the recorded road maps, by scene.
        splits: traversals by role, by split.
        index: ``current``, ``stale`` or ``missing``.
        problems: errors of files that cannot be read.
    """

    document: DatasetDocument
    scenes: Mapping[str, int]
    drives: int
    vehicles: Mapping[str, int]
    vehicle_types: Mapping[str, int]
    rigs: Mapping[str, tuple[str, ...]]
    traversals: int
    images: int
    image_bytes: int
    first_ns: int | None
    last_ns: int | None
    hours: float
    passes: Mapping[str, int]
    layers: Mapping[str, int]
    sweeps: int
    road_maps: Mapping[str, int]
    splits: Mapping[str, Mapping[str, int]]
    index: str
    problems: tuple[MirrorError, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as JSON values, for ``--json``."""
        plain = {_JSON_KEYS.get(name, name): getattr(self, name) for name in self.__dataclass_fields__}
        plain["document"] = self.document.model_dump(mode="json")
        plain["problems"] = [error.to_dict() for error in self.problems]
        return plain


def summarise(root: str | Path) -> DatasetSummary:
    """Summarise a dataset from its documents, manifests and ledgers.

    Args:
        root: its folder.

    Raises:
        DatasetError: the folder holds no dataset.
        SchemaError: ``dataset.json`` is broken or has another schema version.
    """
    with local_tables(root, tables=False) as copy:
        return _summarise(DatasetView.of_copy(copy))


def _summarise(view: DatasetView) -> DatasetSummary:
    layout = view.layout
    if view.document is None:
        raise view.problems[view.name(layout.document)]
    traversals = view.traversals.values()
    images = [manifest.pictures for name in view.traversals if (manifest := view.recorded_manifests[name])]
    passed = [item.ledger_row for item in traversals if item.ledger_row is not None]
    rules = [rule or "accepted" for rule in view.passes.data.column("rule").to_pylist()]
    return DatasetSummary(
        document=view.document,
        scenes={name: sum(item.scene.scene_id == name for item in traversals) for name in view.scenes},
        drives=len(view.drive_manifests),
        vehicles=dict(Counter(drive.vehicle_id for drive in view.drives.values())),
        vehicle_types=dict(Counter(drive.vehicle_type for drive in view.drives.values())),
        rigs={name: tuple(camera.name for camera in rig.cameras) for name, rig in view.rigs.items()},
        traversals=len(traversals),
        images=sum(item.count for item in images if item is not None),
        image_bytes=sum(item.bytes for item in images if item is not None),
        first_ns=min((int(str(row["entry_ns"])) for row in passed), default=None),
        last_ns=max((int(str(row["exit_ns"])) for row in passed), default=None),
        hours=sum(int(str(row["exit_ns"])) - int(str(row["entry_ns"])) for row in passed) / 3.6e12,
        passes=dict(Counter(rules)),
        layers=dict(sorted(Counter(f"{k}/{s}@{v}" for item in traversals for k, s, v in item.layers).items())),
        sweeps=_count_sweeps(view),
        road_maps={name: len(road_map.lanes) for name, road_map in view.road_maps.items()},
        splits={name: dict(Counter(split.assignments.values())) for name, split in view.splits.items()},
        index=_index_state(view),
        problems=tuple(view.problems.values()),
    )


def _count_sweeps(view: DatasetView) -> int:
    folders = [
        (number, view.layout.layer(item.traversal_id, *layer))
        for number, item in enumerate(view.traversals.values())
        for layer in item.layers
        if layer[0] == LIDARS.name
    ]
    return sum(rows.num_rows for _, _, rows in view.parts(LIDARS, folders))


def _index_state(view: DatasetView) -> str:
    state, inputs = view.index_state, view.index_inputs
    if state is None:
        return "missing"
    return "current" if inputs is not None and not find_changes(state.sources, inputs) else "stale"
