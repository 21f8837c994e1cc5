"""Withdrawing an image or a traversal: a new version of a release without it, which says that it is gone."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from mirror.dataset.index import build_index
from mirror.dataset.layout import Layout, manifest_sha256, read_manifest, seal
from mirror.dataset.owned_folder import OwnedFolder, abandoned_folders
from mirror.dataset.splits.split import hash_manifests
from mirror.dataset.taken_down import drop_images
from mirror.errors import UsageError
from mirror.privacy.release.build import write_documents
from mirror.privacy.release.document import Release, Tombstone
from mirror.privacy.release.tree import FROM_IMAGES, LAYER_TABLES, read_drives, read_rig, renumber_frames
from mirror.privacy.release.view import ReleaseView
from mirror.schema.documents import DatasetDocument, ImageTotals, Manifest, Rig, SplitDocument
from mirror.schema.files import encode_table, read_json, read_table, unmovable_error, write_bytes, write_json
from mirror.schema.folders import require_output_folder
from mirror.schema.tables import IMAGES, PASSES


def withdraw(root: str | Path, items: Sequence[str], out: Path, *, reason: str = "") -> Release:
    """Write the next version of a release, without some traversals or images. The present version is not changed.

    What was derived from a withdrawn image goes with it: its masks and depth map, and the points and depth maps of its
    traversal, which it may have helped to make.

    Args:
        root: the release.
        items: ids of traversals, or ``traversal/camera/timestamp_ns`` of images.
        out: folder of the next version; absent or empty.
        reason: why, for the tombstones.

    Returns:
        The document of the next version.

    Raises:
        UsageError: an item is not in the release.
    """
    view = ReleaseView(Path(root))
    require_output_folder(out)
    traversals = {item for item in items if item in view.traversals}
    images = {key for key in view.images if "/".join(map(str, key)) in items}
    if not items:
        raise UsageError("nothing to withdraw is named", expected="ids of traversals or images")
    known = traversals | {"/".join(map(str, key)) for key in images}
    for item in items:
        if item not in known:
            raise UsageError(
                f"{item!r} is not in the release", file=root,
                expected="the id of a traversal, or traversal/camera/timestamp_ns of an image",
                remedy="`mirror info RELEASE` lists traversals; the log lists images",
            )  # fmt: skip
    for abandoned in abandoned_folders(out.absolute().parent, f".{out.name}"):
        shutil.rmtree(abandoned, ignore_errors=True)
    work = OwnedFolder(out.absolute().parent, f".{out.name}")
    try:
        target = Layout(work.path)
        _copy(view, target, traversals)
        rigs = {name: read_rig(view.layout, drive) for drive, names in view.drives for name in names}
        for name in sorted({key[0] for key in images} - traversals):
            _drop_images(target, name, rigs[name], frozenset(key[1:] for key in images if key[0] == name))
        _rewrite_drives(view, target, traversals)
        _rewrite_splits(target, traversals)
        gone = traversals, images
        records = [one for one in view.records if one.traversal_id not in gone[0] and one.key not in gone[1]]
        version = view.release.version + 1
        tombstones = tuple(Tombstone(item=item, version=version, reason=reason) for item in sorted(set(items)))
        release = view.release.model_copy(
            update={"version": version, "tombstones": (*view.release.tombstones, *tombstones)}
        )
        licence = read_json(target.document, DatasetDocument).licence or ""
        write_documents(target, release, records, licence)
        build_index(target.root)
        if out.exists():
            out.rmdir()
        try:
            work.path.rename(out)
        except OSError as error:
            raise unmovable_error(out, error) from error
        work.release()
        return release
    finally:
        work.remove()


def _copy(view: ReleaseView, target: Layout, without: set[str]) -> None:
    """Copy all named files but the index and those of some traversals; files that stay equal are hard links."""
    for name in sorted(view.named_files):
        parts = name.split("/")
        if parts[0] == "index" or (parts[0] == "traversals" and parts[1] in without):
            continue
        source, place = view.root / name, target.root / name
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source, place)
        except OSError:
            shutil.copyfile(source, place)


def _drop_images(target: Layout, name: str, rig: Rig | None, keys: frozenset[tuple[str, int]]) -> None:
    folder = target.recorded(name)
    rows = read_table(folder / "images.parquet", IMAGES)
    for row in rows.to_pylist():
        if (row["camera"], row["timestamp_ns"]) in keys:
            (target.root / row["uri"]).unlink()
    kept = renumber_frames(drop_images(rows, keys), rig)
    write_bytes(folder / "images.parquet", encode_table(kept, IMAGES))
    _reseal(
        folder,
        {},
        ImageTotals(count=kept.num_rows, bytes=int(sum(kept.column("byte_length").to_pylist()))),
    )
    manifest = read_manifest(folder)
    content = "" if manifest is None else manifest.content
    for kind, source, version in target.layers(name):
        layer, table = target.layer(name, kind, source, version), LAYER_TABLES[kind]
        if kind in FROM_IMAGES:
            shutil.rmtree(layer)
            continue
        if "camera" in table.schema.names and "uri" in table.schema.names:
            own = read_table(layer / f"{table.name}.parquet", table)
            for row in own.to_pylist():
                if (row["camera"], row["timestamp_ns"]) in keys:
                    (target.root / row["uri"]).unlink()
            rest = drop_images(own, keys)
            if not rest.num_rows:
                shutil.rmtree(layer)
                continue
            write_bytes(layer / f"{table.name}.parquet", encode_table(rest, table))
        _reseal(layer, {"recorded": content}, None)


def _reseal(folder: Path, derived_from: dict[str, str], images: ImageTotals | None) -> None:
    """Write the manifest of a folder again, for its present files."""
    old = read_json(folder / "manifest.json", Manifest)
    seal(folder, {name: (folder / name).read_bytes() for name in old.files}, derived_from=derived_from, images=images)


def _rewrite_drives(view: ReleaseView, target: Layout, without: set[str]) -> None:
    for drive, names in read_drives(view.layout):
        folder = target.drive(drive.drive_id)
        kept = [name for name in names if name not in without]
        if not kept:
            shutil.rmtree(folder)
            continue
        passes = read_table(folder / "passes.parquet", PASSES)
        ids = passes.column("traversal_id").to_pylist()
        ledger = encode_table(passes.filter(pa.array([value is None or value in kept for value in ids])), PASSES)
        write_bytes(folder / "passes.parquet", ledger)
        hashes = {f"traversal:{name}": manifest_sha256(target.recorded(name)) for name in kept}
        files = {"passes.parquet": ledger, "drive.json": (folder / "drive.json").read_bytes()}
        seal(folder, files, derived_from=hashes)


def _rewrite_splits(target: Layout, without: set[str]) -> None:
    for path in sorted((target.root / "splits").glob("*.json")):
        split = read_json(path, SplitDocument)
        own = {name: role for name, role in split.assignments.items() if name not in without}
        hashes = {}
        for name in own:
            manifest = read_manifest(target.recorded(name))
            hashes[name] = "" if manifest is None else manifest.content
        changes = {
            "assignments": own,
            "manifests": dict(sorted(hashes.items())),
            "dataset_hash": hash_manifests(hashes),
            "added": tuple(name for name in split.added if name in own),
        }
        write_json(path, split.model_copy(update=changes))
