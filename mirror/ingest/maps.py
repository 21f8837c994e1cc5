"""Recorded road maps: read and checked before drives are worked on, added to the dataset after them."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mirror.dataset.generation import supersede
from mirror.dataset.layout import MAPS, Layout, complete_manifest, is_intact, seal
from mirror.dataset.lock import replacing
from mirror.dataset.owned_folder import OwnedFolder, abandoned_folders
from mirror.dataset.recorded_map import MAP_FILE
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import Roi
from mirror.schema.files import sha256_bytes, unmovable_error, write_bytes
from mirror.schema.road_map import read_road_map, require_map_of

MapOutcome = Literal["added", "replaced", "unchanged"]


@dataclass(frozen=True)
class GivenMap:
    """A road map that was given to an ingest run.

    Attributes:
        path: its file.
        scene_id: its scene.
        data: bytes of the file.
    """

    path: Path
    scene_id: str
    data: bytes

    @property
    def sha256(self) -> str:
        """Hash of the bytes."""
        return sha256_bytes(self.data)


def read_given_maps(paths: Sequence[Path], rois: Sequence[Roi]) -> list[GivenMap]:
    """Read and check road maps, sorted by scene.

    Args:
        paths: GeoParquet files, and folders of them (``*.parquet``).
        rois: the scenes of the dataset.

    Raises:
        UsageError: a folder has no map, two files are of one scene, or a map is of no scene of the dataset, in another
            frame, or elsewhere.
        DatasetError: a file is missing.
        SchemaError: a file is not a road map, or a feature is invalid; the feature is named.
    """
    scenes = {roi.scene_id: roi for roi in rois}
    given: dict[str, GivenMap] = {}
    for path in (file for one in paths for file in _files(one)):
        try:
            data = path.read_bytes()
        except OSError as error:
            raise DatasetError(
                f"cannot be read: {error.strerror or error}", file=path, place="--map", expected="a road map"
            ) from error
        road_map = read_road_map(path, data=data)
        if road_map.scene_id not in scenes:
            raise UsageError(
                f"a map of scene {road_map.scene_id}", file=path, place="--map",
                expected=f"a map of a scene of the dataset: {', '.join(scenes)}",
                remedy="add the scene with --rois or --roi, or leave the map out",
            )  # fmt: skip
        require_map_of(road_map, scenes[road_map.scene_id], path)
        if road_map.scene_id in given:
            raise UsageError(
                f"{given[road_map.scene_id].path} is a map of scene {road_map.scene_id} too", file=path, place="--map",
                expected="one map of a scene",
            )  # fmt: skip
        given[road_map.scene_id] = GivenMap(path, road_map.scene_id, data)
    return [given[scene_id] for scene_id in sorted(given)]


def judge_maps(layout: Layout, maps: Sequence[GivenMap], *, replace: bool) -> dict[str, MapOutcome]:
    """Compare given maps with the maps of the dataset, and state the effect of adding each, by scene.

    Args:
        layout: the dataset.
        maps: the maps.
        replace: whether another map of a scene may be replaced.

    Raises:
        UsageError: the dataset has another map of a scene, which may not be replaced.
    """
    outcomes: dict[str, MapOutcome] = {}
    for one in maps:
        manifest = complete_manifest(layout.road_map(one.scene_id))
        entry = None if manifest is None else manifest.files.get(MAP_FILE)
        if entry is None:
            outcomes[one.scene_id] = "added"
        elif entry.sha256 == one.sha256:
            outcomes[one.scene_id] = "unchanged" if is_intact(layout.road_map(one.scene_id)) else "replaced"
        elif replace:
            outcomes[one.scene_id] = "replaced"
        else:
            raise UsageError(
                f"the dataset has another map of scene {one.scene_id}", file=one.path, place="--map",
                expected=f"the map with SHA-256 {entry.sha256}", remedy="--replace replaces it",
            )  # fmt: skip
    return outcomes


def add_maps(layout: Layout, maps: Sequence[GivenMap], outcomes: Mapping[str, MapOutcome]) -> None:
    """Add maps to a dataset, or replace the dataset's maps; the caller holds the writer lock.

    Args:
        layout: the dataset.
        maps: the maps.
        outcomes: the result of `judge_maps`.

    Raises:
        DatasetError: a file cannot be written.
    """
    for one in maps:
        if outcomes[one.scene_id] == "unchanged":
            continue
        folder, work_name = layout.road_map(one.scene_id), f".{one.scene_id}"
        for abandoned in abandoned_folders(layout.root / MAPS, work_name):
            shutil.rmtree(abandoned, ignore_errors=True)
        work = OwnedFolder(layout.root / MAPS, work_name)
        try:
            write_bytes(work.path / MAP_FILE, one.data)
            seal(work.path, {MAP_FILE: one.data}, derived_from={})
            with replacing(layout):
                supersede(layout, folder)
                work.path.rename(folder)
        except OSError as error:
            raise unmovable_error(folder, error) from error
        finally:
            work.remove()


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.glob("*.parquet") if not file.name.startswith("."))
    if not files:
        raise UsageError("no map in the folder", file=path, place="--map", expected="files *.parquet, one a scene")
    return files
