"""The inputs of the index, and their fingerprints. An index is stale if and only if a fingerprint differs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from pydantic import ValidationError

from mirror.dataset.layout import MANIFEST, MAPS
from mirror.dataset.store import Store
from mirror.errors import DatasetError, SchemaError
from mirror.schema.documents import DriveDocument, Manifest, Rig, Roi
from mirror.schema.files import parse_json, sha256_bytes
from mirror.schema.hashing import hash_document
from mirror.schema.problems import describe_problem
from mirror.schema.strict_json import JsonError, decode_json

# Increase this number when the same inputs give another index, so that every index is rebuilt.
DERIVATION: Final = 1
DATASET_KEY: Final = "dataset"
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
        hashes: SHA-256 of the rig's file and of the manifests of the drive, the recorded folder and every layer.
    """

    traversal_id: str
    scene_id: str
    drive: DriveDocument
    rig: Rig | None
    layers: tuple[tuple[str, str, str], ...]
    recorded: Manifest
    hashes: Mapping[str, str]


@dataclass(frozen=True)
class IndexInputs:
    """All inputs of the index.

    Attributes:
        scenes: the regions of interest by scene id, sorted.
        drives: ids of the traversals of each complete drive, by drive id, sorted.
        traversals: inputs of each traversal by id, sorted.
        fingerprints: a hash for each scene (key ``scene:<id>``), one for each recorded road map (``map:<id>``), and one
            of all inputs (key ``dataset``).
    """

    scenes: Mapping[str, Roi]
    drives: Mapping[str, frozenset[str]]
    traversals: Mapping[str, TraversalInput]
    fingerprints: Mapping[str, str]


def read_inputs(store: Store) -> IndexInputs:
    """Read the small files that list all other files: manifests, drive documents, rigs and regions of interest.

    Raises:
        DatasetError: a traversal in a drive's manifest is missing, has another hash, or has an unknown scene.
        SchemaError: a file is broken or has another schema version.
    """
    scenes = read_rois(store)
    manifests = _manifests(
        store, [f"drives/{name}" for name in store.list_folders("drives") if not name.startswith(".")]
    )
    drives: dict[str, frozenset[str]] = {}
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
    drive_hashes = []
    for folder, (manifest, manifest_hash) in manifests.items():
        path = f"{folder}/drive.json"
        if path not in documents:
            raise DatasetError("missing", file=store.full_path(path), remedy="ingest the drive again")
        drive = parse_json(documents[path], DriveDocument, store.full_path(path))
        drive_hashes.append([drive.drive_id, manifest_hash])
        named = {
            key.removeprefix(_TRAVERSAL): value
            for key, value in manifest.derived_from.items()
            if key.startswith(_TRAVERSAL)
        }
        drives[drive.drive_id] = frozenset(named)
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
            traversals[traversal_id] = TraversalInput(traversal_id, scene_id, drive, rig, tuple(own), found[0], hashes)
    ordered = dict(sorted(traversals.items()))
    maps = _manifests(store, [f"{MAPS}/{name}" for name in store.list_folders(MAPS) if not name.startswith(".")])
    map_hashes = {f"map:{folder.removeprefix(f'{MAPS}/')}": value for folder, (_, value) in sorted(maps.items())}
    return IndexInputs(scenes, drives, ordered, _fingerprints(scenes, ordered, drive_hashes, map_hashes))


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


def _fingerprints(
    scenes: Mapping[str, Roi],
    traversals: Mapping[str, TraversalInput],
    drives: list[list[str]],
    maps: Mapping[str, str],
) -> dict[str, str]:
    by_scene: dict[str, list[object]] = {scene_id: [] for scene_id in scenes}
    for traversal in traversals.values():
        by_scene[traversal.scene_id].append([traversal.traversal_id, dict(sorted(traversal.hashes.items()))])
    prints = {
        f"scene:{scene_id}": hash_document([DERIVATION, scenes[scene_id].model_dump(mode="json"), rows])
        for scene_id, rows in by_scene.items()
    }
    prints.update(maps)
    prints[DATASET_KEY] = hash_document([DERIVATION, prints, sorted(drives)])
    return prints
