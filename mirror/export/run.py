"""Writing of an export: images first, then tables, the manifest last; an interrupted call continues when repeated."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Final

import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.export.document import MANIFEST, UNFINISHED, ExportDocument, ExportRequest
from mirror.export.files import encode_image, place_image
from mirror.export.layout import ExportLayout, Written
from mirror.export.leaving import ExportDoor
from mirror.export.lenses import require_lenses
from mirror.export.lidars import place_sweep
from mirror.export.scene import ExportImage, ExportScene, select_scene
from mirror.pools import thread_pool, usable_cores
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.csv_files import Cell, encode_csv
from mirror.schema.documents import FileEntry
from mirror.schema.files import read_json, remove_temporaries, write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.links import require_inside

LAYOUTS: Final = ("colmap", "nerfstudio", "gsplat", "nuscenes", "kitti", "webdataset", "lerobot", "ncore")
"""The formats; each is a module of this package."""

_IMAGES: Final = "images.csv"
_NO_POINTS: Final = (
    "no points: trainers start from random ones, with worse results; `mirror depth DATASET --split NAME` estimates them"
    " from the images of training traversals, and a new --out FOLDER has them"
)


@dataclass(frozen=True)
class ExportOptions:
    """Settings of an export.

    Attributes:
        scene: id of the scene; None: the only one.
        split: split whose roles are exported; traversals without a role are left out. None: all traversals.
        undistort: resample the images of distorted lenses to pinhole cameras.
        copies: copy images, never make hard links.
    """

    scene: str | None = None
    split: str | None = None
    undistort: bool = False
    copies: bool = False


def find_layout(name: str) -> ExportLayout:
    """Return the export format with a given name.

    Raises:
        UsageError: there is no such format.
    """
    if name not in LAYOUTS:
        raise UsageError(f"no export format {name!r}", expected=f"one of {', '.join(LAYOUTS)}")
    layout: ExportLayout = import_module(f"mirror.export.{name}").LAYOUT
    return layout


def export(
    dataset: Dataset,
    layout: str,
    out: Path,
    options: ExportOptions | None = None,
    *,
    progress: ProgressReporter | None = None,
) -> ExportDocument:
    """Export a scene in another format.

    Images are those of the index: where a redaction layer exists, its images and no others. Images that a published
    dataset withholds are left out and counted. All files are held against the images that a redaction replaced before
    the export is sealed. Points come from training traversals only if a split is chosen.

    Args:
        dataset: the view to export; its layers of poses, calibrations, boxes and points are used.
        layout: name of the format, one of `LAYOUTS`.
        out: new folder, or the folder of the same export that was interrupted.
        options: see `ExportOptions`.
        progress: receives the progress.

    Returns:
        The document of the export, which is written last.

    Raises:
        UsageError: the format or the scene is unknown, a lens has no model in the format, a layer must be chosen, a
            package is missing, or `out` is another export or a folder of another kind.
        DatasetError: an image cannot be read, a file cannot be written or must not leave, or the dataset changed
            meanwhile.
    """
    chosen, reporter = options or ExportOptions(), progress or NullProgress()
    form = find_layout(layout)
    existing = require_output_folder(out, FolderKind.EXPORT)
    scene = select_scene(dataset, chosen.scene, chosen.split, undistort=chosen.undistort)
    request = _request(scene, layout, chosen)
    door = ExportDoor(scene.dataset)
    if existing is not None:
        complete = _continued(out, request)
        if complete is not None and complete.sources_sha256 == _hash_sources(scene, reporter):
            return complete
        remove_temporaries(out)
    require_lenses(layout, scene.images, form.lens_of)
    if form.require is not None:
        form.require(scene)
    write_json(out / UNFINISHED, request)
    require_inside(out, MANIFEST).unlink(missing_ok=True)
    sources = _hash_sources(scene, reporter)
    if not form.holds_images:
        _place_images(scene, form, out, copy=chosen.copies, progress=reporter)
    sweeps = None if form.sweeps is None else form.sweeps(scene)
    for place, sweep in ({} if sweeps is None else sweeps.places).items():
        place_sweep(sweep, require_inside(out, place), copy=chosen.copies)
    masks = _write_masks(scene, form, out, reporter)
    written = form.write(scene, out, reporter)
    written = replace(written, notes=(*written.notes, *(() if sweeps is None else sweeps.notes)))
    reporter.start("tables", 1)
    files = [*written.files, *_write_lists(scene, form, out)]
    document = _document(scene, form, request, written, masks, files, out, sources)
    door.require_clean(out, reporter)
    write_json(out / MANIFEST, document)
    (out / UNFINISHED).unlink()
    reporter.advance(1)
    return document


def _request(scene: ExportScene, layout: str, options: ExportOptions) -> ExportRequest:
    layers = scene.dataset.layers
    return ExportRequest(
        layout=layout,
        index_sha256=scene.dataset.index_sha256,
        scene=scene.scene["scene_id"],
        traversals=tuple(scene.traversals),
        cameras=tuple(scene.dataset.cameras()),
        split=options.split,
        poses=layers.poses,
        calibrations=layers.calibrations,
        boxes=layers.boxes,
        points=layers.points,
        undistort=options.undistort,
        copies=options.copies,
    )


def _continued(out: Path, request: ExportRequest) -> ExportDocument | None:
    """The document of a complete export of the same request; None: the export has to be continued.

    Raises:
        UsageError: the folder has the export of another request.
    """
    document = read_json(out / MANIFEST, ExportDocument) if (out / MANIFEST).is_file() else None
    found = document.request if document is not None else read_json(out / UNFINISHED, ExportRequest)
    if found != request:
        different = [name for name in ExportRequest.model_fields if getattr(found, name) != getattr(request, name)]
        raise UsageError(
            f"the folder has an export with another {', '.join(different)}", file=out, place="--out",
            expected="a new folder, or the same export again", remedy="name another folder with --out",
        )  # fmt: skip
    return document


def _hash_sources(scene: ExportScene, progress: ProgressReporter) -> str:
    """Hash of the encoded images that an export is made from; a video is read once for all its frames."""
    progress.start("hashing", len(scene.images))
    parts = {(item.image.uri, item.image.byte_offset): item for item in scene.images}

    def digest(item: ExportImage) -> bytes:
        data = hashlib.sha256(item.image.read()).digest()
        progress.advance(1)
        return data

    with thread_pool(usable_cores()) as pool:
        hashes = dict(zip(parts, pool.map(digest, parts.values())))
    whole = hashlib.sha256()
    for (uri, offset), one in sorted(hashes.items()):
        whole.update(f"{uri} {offset} {one.hex()}\n".encode())
    return whole.hexdigest()


def _place_images(scene: ExportScene, form: ExportLayout, out: Path, *, copy: bool, progress: ProgressReporter) -> None:
    store = scene.dataset.store
    progress.start("images", len(scene.images))

    def place(item: ExportImage) -> None:
        place_image(store, item, out / form.image_path(item), copy=copy)
        progress.advance(1)

    _on_threads(scene.images, place)


def _write_masks(scene: ExportScene, form: ExportLayout, out: Path, progress: ProgressReporter) -> int:
    """Write the masks of the images that have one; returns their number."""
    path_of = form.mask_path
    if path_of is None:
        return 0
    progress.start("masks", len(scene.images))
    unmasked: list[ExportImage] = []

    def write(item: ExportImage) -> None:
        valid = item.valid_pixels()
        if valid is None:
            unmasked.append(item)
        else:
            write_bytes(out / path_of(item), encode_image(valid, ".png"))
        progress.advance(1)

    _on_threads(scene.images, write)
    count = len(scene.images) - len(unmasked)
    if count and form.needs_all_masks:
        for item in unmasked:
            white = np.full((item.lens.height_px, item.lens.width_px), 255, np.uint8)
            write_bytes(out / path_of(item), encode_image(white, ".png"))
        return len(scene.images)
    return count


def _on_threads(images: Sequence[ExportImage], work: Callable[[ExportImage], None]) -> None:
    with thread_pool(usable_cores()) as pool:
        list(pool.map(work, images))


def _write_lists(scene: ExportScene, form: ExportLayout, out: Path) -> list[Path]:
    """Write ``images.csv``, which states the origin of each image, and lists of the images of each role."""
    header = (
        "file", "scene_id", "traversal_id", "drive_id", "frame_index", "camera", "timestamp_ns", "role", "light",
        "weather", "privacy",
    )  # fmt: skip
    rows: list[Sequence[Cell]] = []
    for item in scene.images:
        traversal = scene.traversals[item.frame.traversal_id]
        rows.append(
            [form.image_path(item), item.frame.scene_id, item.frame.traversal_id, item.drive_id,
             item.frame.frame_index, item.image.camera, item.image.timestamp_ns, item.role,
             traversal["light"], traversal["weather"], item.image.privacy]
        )  # fmt: skip
    write_bytes(out / _IMAGES, encode_csv(header, rows))
    files = [out / _IMAGES]
    if form.holds_images:
        return files
    for role in sorted({item.role for item in scene.images if item.role is not None}):
        names = [Path(form.image_path(item)) for item in scene.images if item.role == role]
        lines = [name.relative_to("images").as_posix() if name.parts[0] == "images" else str(name) for name in names]
        write_bytes(out / "splits" / f"{role}.txt", ("\n".join(lines) + "\n").encode())
        files.append(out / "splits" / f"{role}.txt")
    return files


def _document(
    scene: ExportScene, form: ExportLayout, request: ExportRequest, written: Written, masks: int,
    files: Sequence[Path], out: Path, sources: str,
) -> ExportDocument:  # fmt: skip
    entries = {}
    for path in sorted(files):
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        entries[path.relative_to(out).as_posix()] = FileEntry(bytes=path.stat().st_size, sha256=digest)
    x, y, z = scene.origin_m.tolist()
    return ExportDocument(
        request=request,
        origin_m=(x, y, z),
        images=len(scene.images),
        masks=masks + written.masks,
        points=written.points,
        boxes=written.boxes,
        withheld=scene.withheld,
        sources_sha256=sources,
        without_frame=scene.without_frame,
        lost=form.lost,
        notes=(*written.notes, *([_NO_POINTS] if form.holds_points and not written.points else [])),
        files=entries,
    )
