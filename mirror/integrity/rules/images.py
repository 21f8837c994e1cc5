"""Rules of IMG: images, their rows, files and pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Bool, Int64
from mirror.dataset.redaction import REDACTION
from mirror.dataset.splits.candidates import hash_bytes
from mirror.dataset.statistics import stored_bytes
from mirror.integrity.finding import Cost, Finding, Severity
from mirror.integrity.images import MISSING, leaves_dataset
from mirror.integrity.rows import TableRows
from mirror.integrity.rule import scene_rule
from mirror.integrity.scene_view import SceneView


@scene_rule(
    "IMG001",
    Severity.ERROR,
    title="An image's file is missing, and no published bundle withholds it.",
    cost=Cost.FILES,
    remedy="restore the file from the recording, or `mirror ingest RECORDING... --replace`",
)
def _missing(view: SceneView) -> Iterator[Finding]:
    images = view.all_images
    missing = view.image_files.size == MISSING
    if view.dataset.bundle is not None:
        rows = np.flatnonzero(missing)
        stays = _stay(view, [images.text("uri", int(row)) or "" for row in rows])
        missing[rows] = np.logical_not(stays)
    yield from images.findings(missing, lambda row: f"{images.text('uri', row)} is missing or cannot be opened")


def _stay(view: SceneView, uris: Sequence[str]) -> list[bool]:
    """Mark the images that a published bundle leaves out: withheld ones, and those that a redaction replaces."""
    redacted = {item.traversal_id for item in view.traversals if any(kind == REDACTION for kind, _, _ in item.layers)}
    recorded = {f"traversals/{traversal_id}/recorded/" for traversal_id in redacted}
    return [uri in view.dataset.withheld or "/".join([*uri.split("/")[:3], ""]) in recorded for uri in uris]


@scene_rule(
    "IMG002",
    Severity.ERROR,
    title="An image's file is shorter than its bytes, or longer where it holds nothing else, or has another ETag.",
    cost=Cost.FILES,
    remedy="restore the file from the recording, or `mirror ingest RECORDING... --replace`",
)
def _byte_length(view: SceneView) -> Iterator[Finding]:
    images, size = view.all_images, view.image_files.size
    offset, length = images.integers("byte_offset"), images.integers("byte_length")
    short = (size >= 0) & (size < offset + length)
    long = np.flatnonzero((size >= 0) & (offset == 0) & (size > length))
    # A shard holds several images one behind the other, the frames of a video are one file.
    shared = _repeated(images, long)
    video = [images.text("codec", int(row)) == "video" for row in long]
    short[long] |= np.array(video, np.bool_) | ~shared
    yield from images.findings(
        short, lambda row: f"{images.text('uri', row)} has {size[row]} bytes; expected {offset[row] + length[row]}"
    )
    etags, uris = view.etags, images.data.column("uri").to_pylist() if view.etags else []
    changed = np.zeros(len(images), np.bool_)
    changed[: len(uris)] = [
        uri in etags and found is not None and etags[uri] != found for uri, found in zip(uris, view.image_files.etag)
    ]
    yield from images.findings(
        changed & ~short,
        lambda row: f"{uris[row]} has the ETag {view.image_files.etag[row]}; expected {etags[uris[row]]}",
    )


def _repeated(images: TableRows, rows: Int64) -> Bool:
    """Mark the rows among some whose uri other rows of the table have too."""
    uri = images.data.column("uri")
    asked = uri.take(pa.array(rows))
    found = pc.value_counts(uri.filter(pc.is_in(uri, value_set=asked.combine_chunks())))
    count = {item["values"]: item["counts"] for item in found.to_pylist()}
    return np.array([count[value] > 1 for value in asked.to_pylist()], np.bool_)


@scene_rule(
    "IMG003",
    Severity.ERROR,
    title="A JPEG or PNG is cut short: its end marker is missing.",
    cost=Cost.FILES,
    remedy="restore the file from the recording, or drop the image",
)
def _cut_short(view: SceneView) -> Iterator[Finding]:
    images = view.all_images
    yield from images.findings(
        ~view.image_files.ended, lambda row: f"{images.text('uri', row)} has no end-of-image marker"
    )


@scene_rule(
    "IMG004",
    Severity.ERROR,
    title="An image's bytes are not those that were recorded: another SHA-256.",
    cost=Cost.IMAGES,
    remedy="restore the file from the recording, or `mirror ingest RECORDING... --replace`",
)
def _image_hash(view: SceneView) -> Iterator[Finding]:
    images = view.all_images
    yield from images.findings(
        ~view.image_contents.same_bytes, lambda row: f"{images.text('uri', row)} has other bytes than were recorded"
    )


@scene_rule(
    "IMG005",
    Severity.ERROR,
    title="An image with an end marker cannot be decoded.",
    cost=Cost.IMAGES,
    remedy="restore the file from the recording, or drop the image",
)
def _undecodable(view: SceneView) -> Iterator[Finding]:
    images = view.all_images
    yield from images.findings(
        ~view.image_contents.decodes & view.image_files.ended,
        lambda row: f"{images.text('uri', row)} cannot be decoded as {images.text('codec', row)}",
    )


@scene_rule(
    "IMG006",
    Severity.ERROR,
    title="A decoded image has another width or height than its row says.",
    cost=Cost.IMAGES,
    remedy="`mirror ingest RECORDING... --replace`: the table states another size",
)
def _image_size(view: SceneView) -> Iterator[Finding]:
    images, found = view.all_images, view.image_contents
    width, height = images.integers("width_px"), images.integers("height_px")
    decoded = found.width_px > 0
    yield from images.findings(
        decoded & ((found.width_px != width) | (found.height_px != height)),
        lambda row: (
            f"{images.text('uri', row)} is {found.width_px[row]} x {found.height_px[row]} px;"
            f" expected {width[row]} x {height[row]} px"
        ),
    )


_LEAST = 3


@scene_rule(
    "IMG007",
    Severity.WARNING,
    title="An image is blank: all its pixels have the same value, or nearly.",
    cost=Cost.IMAGES,
    remedy="inspect the camera; drop the images if it was covered",
)
def _blank(view: SceneView) -> Iterator[Finding]:
    images, spread = view.all_images, view.image_contents.spread
    yield from images.findings(
        spread < _LEAST, lambda row: f"{images.text('uri', row)}: values differ by {spread[row]} of 255"
    )


@scene_rule(
    "IMG008",
    Severity.WARNING,
    title="Two images of one camera and traversal have the same bytes: a frozen camera.",
    remedy="check whether the camera froze; drop the repeated images in the recording",
)
def _repeated_image(view: SceneView) -> Iterator[Finding]:
    images = view.images
    rows = np.flatnonzero(images.is_known("sha256"))
    hashes = hash_bytes(images.data.column("sha256"))
    words = np.ascontiguousarray(hashes).view(np.uint64)
    camera = images.text_codes("camera")[0]
    # The frames of a video have the hash of the whole video: their time stamps in it tell them apart.
    frame = np.where(images.is_known("video_pts"), images.integers("video_pts"), -1)
    keys = (*words.T, frame[rows], camera[rows], images.owner[rows])
    # The rows of equal keys lie together, the first one first.
    order = np.lexsort((rows, *keys))
    same = np.all([key[order][1:] == key[order][:-1] for key in keys], axis=0) if len(rows) else np.empty(0, np.bool_)
    bad = np.zeros(len(images), np.bool_)
    bad[rows[order[1:][same]]] = True
    yield from images.findings(bad, lambda row: "the bytes of an earlier image of this camera")


@scene_rule(
    "IMG009",
    Severity.INFO,
    title="Images show faces and plates as recorded: they are raw, and no redaction layer replaces them.",
    remedy="de-identify the dataset before it is passed on",
)
def _raw(view: SceneView) -> Iterator[Finding]:
    images = view.images
    codes, words = images.text_codes("privacy")
    redacted = {
        number for number, item in enumerate(view.traversals) if any(kind == "redaction" for kind, *_ in item.layers)
    }
    is_raw = np.isin(codes, [code for code, word in enumerate(words) if word == "raw"])
    yield from images.findings(is_raw & ~np.isin(images.traversal, list(redacted)), lambda row: "privacy is raw")


@scene_rule(
    "IMG010",
    Severity.ERROR,
    title="The uri of an image or mask leads out of the dataset's folder.",
    remedy="do not use this dataset: its tables have been tampered with",
)
def _uri_leads_out(view: SceneView) -> Iterator[Finding]:
    for rows in (view.all_images, view.masks):
        # Nearly no uri has two dots in a row; only those that have are taken apart.
        suspects = np.flatnonzero(pc.match_substring(rows.data.column("uri"), "..").to_numpy())
        outside = np.zeros(len(rows), np.bool_)
        outside[suspects] = [leaves_dataset(str(rows.text("uri", int(row)))) for row in suspects]
        yield from rows.findings(
            outside,
            lambda row, rows=rows: f"uri {rows.text('uri', row)!r}",  # type: ignore[misc]
        )


@scene_rule(
    "IMG011",
    Severity.ERROR,
    title="A traversal's manifest states another number or size of images than its images table.",
    remedy="`mirror ingest RECORDING... --replace`",
)
def _image_total(view: SceneView) -> Iterator[Finding]:
    for file, number, rows in view.images.slices():
        stated = view.dataset.recorded_manifests[view.traversals[number].traversal_id].pictures
        count = rows.stop - rows.start
        total = stored_bytes(view.images.data.slice(rows.start, count))
        if (stated.count, stated.bytes) != (count, total) if stated is not None else count > 0:
            says = f"{stated.count} images of {stated.bytes} bytes" if stated is not None else "nothing of images"
            yield Finding(file, None, f"{count} images of {total} bytes, but the manifest says {says}")


@scene_rule(
    "IMG012",
    Severity.ERROR,
    title="An image in a video has no `video_pts`, or one that lies in a file of its own has one.",
    remedy="`mirror ingest RECORDING... --replace`",
)
def _video_stamp(view: SceneView) -> Iterator[Finding]:
    images = view.all_images
    codes, words = images.text_codes("codec")
    video = np.isin(codes, [code for code, word in enumerate(words) if word == "video"])
    stamped = images.is_known("video_pts")
    yield from images.findings(
        video != stamped,
        lambda row: f"codec {images.text('codec', row)} {'without' if video[row] else 'with'} video_pts",
    )


@scene_rule(
    "IMG013",
    Severity.INFO,
    title="Images are unverified: their rows have no hash, at most a size or an ETag.",
    remedy="ingest with --hash; images by uri with `--references sha256`",
)
def _unverified(view: SceneView) -> Iterator[Finding]:
    images = view.images
    yield from images.findings(
        ~images.is_known("sha256"),
        lambda row: f"{images.text('uri', row)} has no SHA-256: unverified",
    )
