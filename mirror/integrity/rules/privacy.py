"""Rules of PRV: redacted images, and what was derived from images before they were redacted."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mirror.dataset.images.metadata import list_metadata
from mirror.dataset.layout import read_manifest
from mirror.dataset.redaction import REDACTION, current_redaction, newest_redaction
from mirror.errors import MirrorError
from mirror.integrity.finding import Cost, Finding, Severity
from mirror.integrity.images import leaves_dataset
from mirror.integrity.rule import scene_rule
from mirror.integrity.scene_view import SceneView
from mirror.schema.files import read_table
from mirror.schema.json_lines import decode_object
from mirror.schema.strict_json import JsonError
from mirror.schema.tables import IMAGES

_FROM_IMAGES = ("depth", "points")


@scene_rule(
    "PRV001",
    Severity.ERROR,
    title="A redaction layer leaves out images of its traversal: readers get these as they were recorded.",
    remedy="`mirror deidentify` under another version; a release leaves these images out",
)
def _left_out(view: SceneView) -> Iterator[Finding]:
    layout = view.dataset.layout
    for file, number, rows in view.images.slices():
        item = view.traversals[number]
        newest = newest_redaction(item.layers)
        if newest is None:
            continue
        path = layout.layer(item.traversal_id, REDACTION, *newest) / "images.parquet"
        try:
            count = read_table(path, IMAGES, ["camera"]).num_rows
        except MirrorError:
            # The rules of TAB name the fault.
            continue
        missing = rows.stop - rows.start - count
        if missing > 0:
            yield Finding(file, None, f"{missing} of {rows.stop - rows.start} images are not redacted", missing)


@scene_rule(
    "PRV002",
    Severity.ERROR,
    title="Depth maps or points were derived from other images than the present redacted ones.",
    remedy="derive the layer again under another version, and remove this one",
)
def _stale(view: SceneView) -> Iterator[Finding]:
    layout = view.dataset.layout
    for item in view.traversals:
        try:
            current = current_redaction(layout, item.traversal_id)
        except MirrorError:
            continue
        for kind, source, version in item.layers if current is not None else ():
            folder = layout.layer(item.traversal_id, kind, source, version)
            manifest = read_manifest(folder) if kind in _FROM_IMAGES else None
            if manifest is not None and manifest.derived_from.get(REDACTION) != current:
                yield Finding(view.dataset.name(folder), "derived_from", "it may show what has been redacted since")


@scene_rule(
    "PRV003",
    Severity.ERROR,
    title="A redacted image holds metadata, a thumbnail, or bytes after its end.",
    cost=Cost.IMAGES,
    remedy="`mirror deidentify` under another version",
)
def _metadata(view: SceneView) -> Iterator[Finding]:
    images, store = view.all_images, view.dataset.store
    codes, words = images.text_codes("privacy")
    redacted = np.isin(codes, [code for code, word in enumerate(words) if word == "redacted"])
    offset, length = images.integers("byte_offset"), images.integers("byte_length")
    bad = np.zeros(len(images), np.bool_)
    held: dict[int, str] = {}
    for row in np.flatnonzero(redacted).tolist():
        uri = str(images.text("uri", row))
        place = None if leaves_dataset(uri) or images.text("codec", row) == "video" else store.resolve(uri)
        if not isinstance(place, Path) or not place.is_file():
            continue
        try:
            size = min(int(length[row]), place.stat().st_size)
            found = list_metadata(store.read_range(uri, int(offset[row]), size), uri)
        except (OSError, MirrorError):
            # The rules of IMG name the fault.
            continue
        bad[row], held[row] = bool(found), ", ".join(found)
    yield from images.findings(bad, lambda row: f"{images.text('uri', row)} holds {held[row]}")


@scene_rule(
    "PRV004",
    Severity.WARNING,
    title="A redaction layer has no log: nobody can tell what was removed, and it cannot be released.",
    remedy="`mirror deidentify` under another version",
)
def _log(view: SceneView) -> Iterator[Finding]:
    for item in view.traversals:
        newest = newest_redaction(item.layers)
        if newest is None:
            continue
        folder = view.dataset.layout.layer(item.traversal_id, REDACTION, *newest)
        if not (folder / "log.jsonl").is_file():
            yield Finding(view.dataset.name(folder), None, "no log.jsonl")


@scene_rule(
    "PRV005",
    Severity.ERROR,
    title="An image was redacted from other bytes than those that are recorded: what it shows was not searched.",
    remedy="`mirror deidentify` under another version; readers get the newest",
)
def _other_sources(view: SceneView) -> Iterator[Finding]:
    layout = view.dataset.layout
    for item in view.traversals:
        newest = newest_redaction(item.layers)
        if newest is None:
            continue
        log = layout.layer(item.traversal_id, REDACTION, *newest) / "log.jsonl"
        try:
            table = read_table(layout.recorded(item.traversal_id) / "images.parquet", IMAGES)
            lines = [decode_object(line) for line in log.read_bytes().splitlines()]
        except (MirrorError, OSError, JsonError):
            # Other rules name the fault.
            continue
        columns = [table.column(name).to_pylist() for name in ("camera", "timestamp_ns", "sha256")]
        recorded = {(camera, stamp): sha256 for camera, stamp, sha256 in zip(*columns)}
        others = [
            line
            for line in lines
            if line.get("source_sha256") is not None
            and (sha256 := recorded.get((line.get("camera"), line.get("timestamp_ns")))) is not None
            and sha256.hex() != line["source_sha256"]
        ]
        if others:
            first = f"camera {others[0].get('camera')}, timestamp_ns {others[0].get('timestamp_ns')}"
            yield Finding(view.dataset.name(log), first, f"{len(others)} images of other recorded bytes", len(others))
