"""The inputs of the index, and their fingerprints. An index is stale if and only if a fingerprint differs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from pydantic import ValidationError

from mirror.dataset.layout import MANIFEST, MAPS
from mirror.dataset.store import Store
from mirror.dataset.taken_down import CameraStamp, group_by_traversal, read_take_downs
from mirror.errors import DatasetError, SchemaError
from mirror.schema.documents import DriveDocument, Manifest, Rig, Roi
from mirror.schema.files import parse_json, sha256_bytes
from mirror.schema.hashing import hash_document
from mirror.schema.problems import describe_problem
from mirror.schema.snapshot import DriveSource, SegmentSources
from mirror.schema.strict_json import JsonError, decode_json

# Increase this number when the same inputs give another index, so that every index is rebuilt.
DERIVATION: Final = 1
DATASET_KEY: Final = "dataset"
TAKEN_DOWN_KEY: Final = "taken_down"
_TRAVERSAL: Final = "traversal:"


@dataclass(frozen=True)
class TraversalInput:
    """The inputs of one traversal's rows.

    Attributes:
        traversal_id: the traversal.
        scene_id: its scene.
        drive: its drive.
        rig: the rig of the drive; None: the drive has no cameras.
        layers: kind, source and version of its complete layers.
        recorded: manifest of the recorded folder.
        taken_down: its images that were taken down.
        hashes: SHA-256 of the rig's file and of the manifests of the drive, the recorded folder and every layer.
    """

    traversal_id: str
    scene_id: str
    drive: DriveDocument
    rig: Rig | None
    layers: tuple[tuple[str, str, str], ...]
    recorded: Manifest
    taken_down: frozenset[CameraStamp]
    hashes: Mapping[str, str]


@dataclass(frozen=True)
class IndexInputs:
    """All inputs of the index, or those of a part of it.

    Attributes:
        scenes: the regions of interest by scene id, sorted.
        drives: ids of the traversals of each complete drive, by drive id, sorted.
        traversals: inputs of each traversal by id, sorted.
        documents: documents of the drives, by drive id.
        drive_hashes: SHA-256 of the drives' manifests, by drive id.
        map_hashes: SHA-256 of the manifests of recorded road maps, by scene id, sorted.
    """

    scenes: Mapping[str, Roi]
    drives: Mapping[str, frozenset[str]]
    traversals: Mapping[str, TraversalInput]
    documents: Mapping[str, DriveDocument]
    drive_hashes: Mapping[str, str]
    map_hashes: Mapping[str, str]

    @cached_property
    def fingerprints(self) -> Mapping[str, str]:
        """A hash for each scene (key ``scene:<id>``) and road map (``map:<id>``), and one of all (key ``dataset``)."""
        by_scene: dict[str, list[object]] = {scene_id: [] for scene_id in self.scenes}
        for one in self.traversals.values():
            by_scene.setdefault(one.scene_id, []).append([one.traversal_id, dict(sorted(one.hashes.items()))])
        prints = {
            f"scene:{scene_id}": hash_document([DERIVATION, self._plain_roi(scene_id), rows])
            for scene_id, rows in by_scene.items()
        }
        prints.update({f"map:{scene_id}": value for scene_id, value in self.map_hashes.items()})
        drives = sorted([drive_id, value] for drive_id, value in self.drive_hashes.items())
        prints[DATASET_KEY] = hash_document([DERIVATION, prints, drives])
        return prints

    def _plain_roi(self, scene_id: str) -> dict[str, object] | None:
        return self.scenes[scene_id].model_dump(mode="json") if scene_id in self.scenes else None

    @cached_property
    def sources(self) -> SegmentSources:
        """Hashes of all inputs, one for each file."""
        drives = {}
        for drive_id, named in self.drives.items():
            document = self.documents[drive_id]
            drives[drive_id] = DriveSource(
                manifest=self.drive_hashes[drive_id],
                source=document.source.fingerprint,
                configuration=document.configuration,
                scenes=document.scenes,
                traversals={key: dict(sorted(self.traversals[key].hashes.items())) for key in sorted(named)},
            )
        scenes = {scene_id: hash_document(self._plain_roi(scene_id)) for scene_id in self.scenes}
        return SegmentSources(derivation=DERIVATION, drives=drives, scenes=scenes, maps=dict(self.map_hashes))

    def part(self, drives: Collection[str], scenes: Collection[str], maps: Collection[str] = ()) -> IndexInputs:
        """Return the inputs of some drives, of the rows of some scenes, and of the maps of some scenes."""
        chosen = {drive_id: named for drive_id, named in self.drives.items() if drive_id in drives}
        return IndexInputs(
            {scene_id: roi for scene_id, roi in self.scenes.items() if scene_id in scenes},
            chosen,
            {key: one for key, one in self.traversals.items() if one.drive.drive_id in chosen},
            {drive_id: self.documents[drive_id] for drive_id in chosen},
            {drive_id: self.drive_hashes[drive_id] for drive_id in chosen},
            {scene_id: value for scene_id, value in self.map_hashes.items() if scene_id in maps},
        )


def read_inputs(store: Store, drives: Collection[str] | None = None) -> IndexInputs:
    """Read the small files that list all other files: manifests, drive documents, rigs and regions of interest.

    Args:
        store: the dataset's files.
        drives: read only these drives; None: all.

    Raises:
        DatasetError: a traversal in a drive's manifest is missing, has another hash, or has an unknown scene.
        SchemaError: a file is broken or has another schema version.
    """
    scenes = read_rois(store)
    names = [name for name in store.list_folders("drives") if not name.startswith(".")] if drives is None else drives
    manifests = _manifests(store, [f"drives/{name}" for name in sorted(names)])
    found_drives: dict[str, frozenset[str]] = {}
    drive_documents: dict[str, DriveDocument] = {}
    traversals: dict[str, TraversalInput] = {}
    documents = store.read_many([f"{folder}/drive.json" for folder in manifests])
    recorded = _manifests(
        store,
        [
            f"traversals/{name}/recorded"
            for manifest, _ in manifests.values()
            for name in (key.removeprefix(_TRAVERSAL) for key in manifest.derived_from if key.startswith(_TRAVERSAL))
        ],
    )
    layers = _layers(store, [folder.removesuffix("/recorded") for folder in recorded])
    rigs: dict[str, tuple[Rig, str]] = {}
    taken_down = group_by_traversal(read_take_downs(store))
    drive_hashes: dict[str, str] = {}
    for folder, (manifest, manifest_hash) in manifests.items():
        path = f"{folder}/drive.json"
        if path not in documents:
            raise DatasetError("missing", file=store.full_path(path), remedy="ingest the drive again")
        drive = parse_json(documents[path], DriveDocument, store.full_path(path))
        drive_documents[drive.drive_id], drive_hashes[drive.drive_id] = drive, manifest_hash
        named = {
            key.removeprefix(_TRAVERSAL): value
            for key, value in manifest.derived_from.items()
            if key.startswith(_TRAVERSAL)
        }
        found_drives[drive.drive_id] = frozenset(named)
        rig = rig_hash = None
        if named and drive.rig_id is not None:
            if drive.rig_id not in rigs:
                rigs[drive.rig_id] = _read_rig(store, drive.rig_id)
            rig, rig_hash = rigs[drive.rig_id]
        for traversal_id, expected in named.items():
            place = f"traversals/{traversal_id}/recorded"
            found = recorded.get(place)
            if found is None or found[1] != expected:
                raise DatasetError(
                    "missing" if found is None else "not the traversal that its drive was written with",
                    file=store.full_path(place),
                    place=MANIFEST,
                    expected=f"the manifest with SHA-256 {expected}",
                    remedy=f"ingest drive {drive.drive_id} again",
                )
            scene_id = traversal_id.partition(".")[0]
            if scene_id not in scenes:
                raise DatasetError(
                    f"the scene of traversal {traversal_id} is missing",
                    file=store.full_path("rois.geojson"),
                    expected=f"a feature with scene_id {scene_id!r}",
                    remedy="restore the file",
                )
            own = layers.get(f"traversals/{traversal_id}", {})
            hashes = {f"drive:{drive.drive_id}": manifest_hash, "recorded": expected}
            if rig_hash is not None:
                hashes[f"rig:{drive.rig_id}"] = rig_hash
            hashes.update({f"layer:{kind}/{source}@{version}": value for (kind, source, version), value in own.items()})
            gone = taken_down.get(traversal_id, frozenset())
            if gone:
                hashes[TAKEN_DOWN_KEY] = hash_document(sorted(gone))
            traversals[traversal_id] = TraversalInput(
                traversal_id, scene_id, drive, rig, tuple(own), found[0], gone, hashes
            )
    ordered = dict(sorted(traversals.items()))
    maps = _manifests(store, [f"{MAPS}/{name}" for name in store.list_folders(MAPS) if not name.startswith(".")])
    map_hashes = {folder.removeprefix(f"{MAPS}/"): value for folder, (_, value) in sorted(maps.items())}
    return IndexInputs(scenes, found_drives, ordered, drive_documents, drive_hashes, map_hashes)


def read_rois(store: Store) -> dict[str, Roi]:
    """Read the dataset's regions of interest, by scene id, sorted.

    Raises:
        DatasetError: ``rois.geojson`` is missing.
        SchemaError: the file is no collection of regions of interest, or an id repeats.
    """
    name = store.full_path("rois.geojson")
    try:
        raw = decode_json(store.read("rois.geojson"))
    except FileNotFoundError as error:
        raise DatasetError("missing", file=name, expected="the scenes as GeoJSON", remedy="restore the file") from error
    except JsonError as error:
        raise SchemaError(str(error), file=name, place=error.place, remedy="restore the file") from error
    features = raw.get("features") if isinstance(raw, dict) else None
    if not isinstance(features, list):
        raise SchemaError("not a FeatureCollection", file=name, place="features", remedy="restore the file")
    scenes: dict[str, Roi] = {}
    for number, feature in enumerate(features):
        try:
            roi = Roi.model_validate(feature.get("properties") if isinstance(feature, dict) else None)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in ("features", number, "properties", *first["loc"]))
            raise SchemaError(
                describe_problem(first), file=name, place=place, expected="a region of interest"
            ) from error
        if roi.scene_id in scenes:
            raise SchemaError(
                f"scene {roi.scene_id} is there twice",
                file=name,
                place=f"features.{number}",
                remedy="give one of the two another scene_id",
            )
        scenes[roi.scene_id] = roi
    return dict(sorted(scenes.items()))


def _manifests(store: Store, folders: list[str]) -> dict[str, tuple[Manifest, str]]:
    """Manifests and their hashes, by folder; folders without a manifest are ignored."""
    found = store.read_many([f"{folder}/{MANIFEST}" for folder in folders])
    return {
        path.removesuffix(f"/{MANIFEST}"): (parse_json(data, Manifest, store.full_path(path)), sha256_bytes(data))
        for path, data in found.items()
    }


def _layers(store: Store, traversals: list[str]) -> dict[str, dict[tuple[str, str, str], str]]:
    """Hashes of the complete layers, by traversal folder, then by kind, source and version, sorted."""
    kinds = store.list_folders_of([f"{traversal}/layers" for traversal in traversals])
    names = store.list_folders_of([f"{layers}/{kind}" for layers, own in kinds.items() for kind in own])
    folders = {f"{kind}/{name}" for kind, own in names.items() for name in own if not name.startswith(".")}
    found: dict[str, dict[tuple[str, str, str], str]] = {}
    for path, data in sorted(store.read_many([f"{folder}/{MANIFEST}" for folder in sorted(folders)]).items()):
        traversal, _, layer = path.removesuffix(f"/{MANIFEST}").partition("/layers/")
        kind, _, name = layer.partition("/")
        source, _, version = name.partition("@")
        found.setdefault(traversal, {})[(kind, source, version)] = sha256_bytes(data)
    return {traversal: dict(sorted(own.items())) for traversal, own in found.items()}


def _read_rig(store: Store, rig_id: str) -> tuple[Rig, str]:
    path = f"rigs/{rig_id}.json"
    try:
        data = store.read(path)
    except FileNotFoundError as error:
        raise DatasetError(
            "missing", file=store.full_path(path), expected="a rig", remedy="restore the file"
        ) from error
    return parse_json(data, Rig, store.full_path(path)), sha256_bytes(data)
