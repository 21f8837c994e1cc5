"""Recorded road maps in a dataset: ``maps/<scene_id>/map.parquet``, as it was given, beside its manifest."""

from __future__ import annotations

from typing import Final

from mirror.dataset.layout import MANIFEST, MAPS
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.schema.documents import Manifest, Roi
from mirror.schema.files import parse_json, sha256_bytes
from mirror.schema.road_map import RoadMap, read_road_map, require_map_of

MAP_FILE: Final = "map.parquet"
REMEDY: Final = "restore the file, or add the map again: mirror ingest --map FILE --replace --out DATASET"


def read_recorded_map(store: Store, roi: Roi) -> RoadMap | None:
    """Read the recorded road map of a scene, checked against its manifest; None without a recorded map.

    Args:
        store: the dataset's files.
        roi: region of interest of the scene.

    Raises:
        UsageError: the map is of another scene or in another frame.
        DatasetError: the map's file is missing or was changed.
        SchemaError: a file is broken, or a feature is invalid; the feature is named.
    """
    folder = f"{MAPS}/{roi.scene_id}"
    path, manifest_path = f"{folder}/{MAP_FILE}", f"{folder}/{MANIFEST}"
    found = store.read_many([manifest_path, path])
    if manifest_path not in found:
        return None
    manifest = parse_json(found[manifest_path], Manifest, store.full_path(manifest_path))
    entry, data = manifest.files.get(MAP_FILE), found.get(path)
    if entry is None or data is None or sha256_bytes(data) != entry.sha256:
        raise DatasetError(
            "missing, or not the file that was written",
            file=store.full_path(path),
            expected=f"the file with the hash that {MANIFEST} states",
            remedy=REMEDY,
        )
    road_map = read_road_map(store.full_path(path), data=data)
    require_map_of(road_map, roi, store.full_path(path))
    return road_map
