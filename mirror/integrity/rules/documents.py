"""Rules of DS: the dataset's documents, folders and ids."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from mirror.dataset.images.decoding import decode_grey
from mirror.dataset.layout import MANIFEST, manifest_sha256
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Cost, Finding, Severity
from mirror.integrity.problems import report_unreadable
from mirror.integrity.rule import dataset_rule
from mirror.schema.documents import is_identifier
from mirror.schema.take_downs import TAKE_DOWNS


@dataset_rule(
    "DS001",
    Severity.ERROR,
    title="dataset.json or take_downs.json is broken, or of a schema version that cannot be read.",
    remedy="restore the file; without dataset.json, ingest into a new folder",
)
def _dataset_document(view: DatasetView) -> Iterator[Finding]:
    if view.document is None:
        yield from report_unreadable(view.problems, lambda file: file == "dataset.json")
    _ = view.taken_down
    yield from report_unreadable(view.problems, lambda file: file == TAKE_DOWNS)


@dataset_rule(
    "DS002",
    Severity.ERROR,
    title="rois.geojson is missing or broken, or a scene is in it twice.",
    remedy="restore rois.geojson",
)
def _regions(view: DatasetView) -> Iterator[Finding]:
    if not view.scenes:
        yield from report_unreadable(view.problems, lambda file: file == "rois.geojson")


@dataset_rule(
    "DS003",
    Severity.ERROR,
    title="A rig that a drive names is missing or broken, or its file has another rig's name.",
    remedy="restore the file, or ingest a drive with that rig again",
)
def _rig(view: DatasetView) -> Iterator[Finding]:
    for rig_id, document in view.rigs.items():
        if document.rig_id != rig_id:
            yield Finding(f"rigs/{rig_id}.json", "rig_id", f"holds rig {document.rig_id!r}")
    yield from report_unreadable(view.problems, lambda file: file.startswith("rigs/"))


@dataset_rule(
    "DS004",
    Severity.ERROR,
    title="A drive.json is missing or broken, or in the folder of another drive.",
    remedy="run the same `mirror ingest` again with --verify",
)
def _drive_document(view: DatasetView) -> Iterator[Finding]:
    for name, document in view.drives.items():
        if document.drive_id != name:
            yield Finding(f"drives/{name}/drive.json", "drive_id", f"holds drive {document.drive_id!r}")
    yield from report_unreadable(view.problems, lambda file: file.endswith("/drive.json"))


@dataset_rule(
    "DS005",
    Severity.ERROR,
    title="A manifest.json is broken.",
    remedy="run the same `mirror ingest` again with --verify, or write the layer again",
)
def _manifest(view: DatasetView) -> Iterator[Finding]:
    _ = view.folder_manifests
    yield from report_unreadable(
        view.problems, lambda file: file.endswith("/manifest.json") and not file.startswith("index/")
    )


@dataset_rule(
    "DS006",
    Severity.WARNING,
    title="A folder has no manifest: a run was interrupted there, and readers pass it over.",
    remedy="run the same `mirror ingest` again with --verify: it finishes or removes the folder",
)
def _incomplete_folder(view: DatasetView) -> Iterator[Finding]:
    for folder in view.folders_with_manifest():
        if not (folder / MANIFEST).is_file():
            yield Finding(view.name(folder), MANIFEST, "missing: the folder is not complete")


@dataset_rule(
    "DS007",
    Severity.ERROR,
    title="A drive names a traversal that is missing, or that is not the one it was written with.",
    remedy="run the same `mirror ingest` again with --verify",
)
def _named_traversal(view: DatasetView) -> Iterator[Finding]:
    for traversal_id, (drive, expected) in view.named_traversals.items():
        file = f"traversals/{traversal_id}/recorded/{MANIFEST}"
        if not (view.layout.root / file).is_file():
            yield Finding(file, None, f"missing, but drive {drive} names the traversal")
        elif (found := manifest_sha256(view.layout.recorded(traversal_id))) != expected:
            yield Finding(file, None, f"SHA-256 is {found}, but drive {drive} was written with {expected}")


@dataset_rule(
    "DS008",
    Severity.WARNING,
    title="A traversal is complete, but no drive names it, so that readers pass it over.",
    remedy="run the same `mirror ingest` again with --verify, or remove the folder",
)
def _orphan_traversal(view: DatasetView) -> Iterator[Finding]:
    for traversal_id in view.recorded_manifests:
        if traversal_id not in view.named_traversals:
            yield Finding(f"traversals/{traversal_id}", None, "no drive's manifest names this traversal")


_LAYER_KINDS = ("poses", "calibrations", "boxes", "masks", "redaction", "depth", "points", "lidars")


@dataset_rule(
    "DS009",
    Severity.ERROR,
    title="A folder's name is no id: `drive`, `scene.drive.entry_ms`, or `kind/source@version` of a layer.",
    remedy="ids are assigned once: undo the renaming, or write the folder again",
)
def _identifier(view: DatasetView) -> Iterator[Finding]:
    for folder in view.folders("drives"):
        if not is_identifier(folder.name):
            yield Finding(view.name(folder), None, "not a drive's id: letters, digits, `_` and `-`")
    for folder in view.folders("traversals"):
        parts = folder.name.split(".")
        if len(parts) != 3 or not (is_identifier(parts[0]) and is_identifier(parts[1]) and parts[2].isdigit()):
            yield Finding(view.name(folder), None, "not a traversal's id: scene.drive.entry_ms")
        for layer in view.layer_folders(folder.name):
            source, at, version = layer.name.partition("@")
            if layer.parent.name not in _LAYER_KINDS or not (source and at and version):
                yield Finding(view.name(layer), None, f"not a layer: {' | '.join(_LAYER_KINDS)}, then source@version")


@dataset_rule(
    "DS010",
    Severity.ERROR,
    title="A traversal is of a scene that is not in rois.geojson.",
    remedy="restore the scene in rois.geojson",
)
def _unknown_scene(view: DatasetView) -> Iterator[Finding]:
    for traversal_id in view.named_traversals:
        scene_id = traversal_id.partition(".")[0]
        if view.scenes and scene_id not in view.scenes:
            yield Finding("rois.geojson", f"scene {scene_id}", f"missing, but traversal {traversal_id} is of it")


@dataset_rule(
    "DS011",
    Severity.WARNING,
    title="One vehicle has several vehicle types.",
    remedy="give the vehicles different ids, or correct the type, and `mirror ingest RECORDING... --replace`",
)
def _vehicle(view: DatasetView) -> Iterator[Finding]:
    types: dict[str, dict[str, str]] = defaultdict(dict)
    for name, drive in view.drives.items():
        types[drive.vehicle_id].setdefault(drive.vehicle_type, name)
    for vehicle_id, own in types.items():
        if len(own) > 1:
            listed = ", ".join(f"{kind!r} in drive {name}" for kind, name in own.items())
            yield Finding(
                f"drives/{list(own.values())[1]}/drive.json", "vehicle_type", f"vehicle {vehicle_id}: {listed}"
            )


@dataset_rule(
    "DS012",
    Severity.ERROR,
    title="A static mask that a rig names is missing, or is not a PNG.",
    cost=Cost.FILES,
    remedy="restore the mask beside the rig's file",
)
def _static_mask(view: DatasetView) -> Iterator[Finding]:
    for rig_id, rig in view.rigs.items():
        for camera in rig.cameras:
            if camera.static_mask is None:
                continue
            path = view.layout.rig(rig_id).parent / camera.static_mask
            if not path.is_file():
                yield Finding(
                    f"rigs/{camera.static_mask}", None, f"missing, but camera {camera.name} of the rig names it"
                )
            elif decode_grey(path.read_bytes()) is None:
                yield Finding(f"rigs/{camera.static_mask}", None, "cannot be decoded")


@dataset_rule(
    "DS013",
    Severity.INFO,
    title="The dataset states no licence.",
    remedy="write the licence into dataset.json before the dataset is passed on",
)
def _licence(view: DatasetView) -> Iterator[Finding]:
    if view.document is not None and not view.document.licence:
        yield Finding("dataset.json", "licence", "null")
