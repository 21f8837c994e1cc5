"""The layers of a de-identified traversal: redacted images with their log, and masks of what was replaced."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Final

import pyarrow as pa

from mirror.dataset.derived_layer import DerivedLayer
from mirror.dataset.images.binary_mask import encode_mask
from mirror.dataset.images.video_decoders import VideoDecoders
from mirror.dataset.layer_writer import RECORDED, LayerWriter, remove_layer
from mirror.dataset.layout import Layout, read_manifest
from mirror.dataset.redaction import REDACTION
from mirror.dataset.store import Store
from mirror.pools import thread_pool
from mirror.privacy.detection import ImageKey, out_codec, read_recorded, redact_recorded
from mirror.privacy.encoding import RedactedImage
from mirror.privacy.log import LOG, DetectorRecord, ImageRecord, encode_log
from mirror.privacy.operators import Redaction
from mirror.privacy.regions import Region
from mirror.schema.finished_work import hash_values
from mirror.schema.tables import IMAGES, MASKS

SOURCE: Final = "deidentify"
MASK_KIND: Final = "redaction"
_AT_ONCE: Final = 4
_SEARCHED: Final = "searched"
_DESCRIBED: Final = (
    "the same detectors, weights, thresholds, region of number plates, other options and recorded images"
)
_REMEDY: Final = "write another version beside it: --version NAME; the newest is the one that readers get"


@dataclass(frozen=True)
class Configuration:
    """Settings that the layers of one version share.

    Attributes:
        version: version of the layers.
        sha256: hash of detectors and options.
        detectors: the detectors.
        redaction: operators and margins.
        plate_region: region of the number plates, for the log.
    """

    version: str
    sha256: str
    detectors: tuple[DetectorRecord, ...]
    redaction: Redaction
    plate_region: str | None = None


def redaction_layer(layout: Layout, traversal_id: str, configuration: Configuration) -> DerivedLayer:
    """Return the layer of redacted images of one traversal, which may be missing."""
    return DerivedLayer(
        layout, traversal_id, REDACTION, SOURCE, configuration.version, {"configuration": configuration.sha256},
        _DESCRIBED, frozenset({_SEARCHED, REDACTION}), _REMEDY,
    )  # fmt: skip


def write_layers(
    layout: Layout,
    traversal_id: str,
    rows: Mapping[ImageKey, Mapping[str, Any]],
    regions: Mapping[ImageKey, Sequence[Region]],
    skipped: Mapping[ImageKey, Mapping[str, int]],
    configuration: Configuration,
    *,
    workers: int,
    shards: bool = False,
) -> None:
    """Write the layer of masks, then the layer of redacted images, which is complete with its log or absent.

    A few images are in memory at a time.

    Args:
        layout: the dataset; the caller holds its writer lock.
        traversal_id: the traversal.
        rows: rows of the recorded images table, by image, with the hashes of the bytes that were searched.
        regions: what is removed, by image.
        skipped: tiles that were not searched, by image.
        configuration: detectors and operators.
        workers: number of threads.
        shards: write the images side by side into tar archives, frame by frame; masks are a file each.

    Raises:
        DatasetError: an image cannot be read or written; a layer of another configuration exists.
    """
    store = Store(layout.root)
    searched = _hash_searched(rows, regions)
    images = redaction_layer(layout, traversal_id, configuration).open()
    masks = _open_masks(layout, traversal_id, configuration, searched)
    image_rows, mask_rows, records = [], [], []
    for key, redacted in _redacted(store, rows, regions, configuration.redaction, workers):
        camera, timestamp_ns = key
        row = dict(rows[key])
        codec = out_codec(row)
        written = images.file(f"{camera}/{timestamp_ns}.{'png' if codec == 'png' else 'jpg'}", redacted.data)
        image_rows.append(
            {**row, **written, "byte_offset": 0, "codec": codec, "video_pts": None, "privacy": "redacted"}
        )
        digest = written["sha256"]
        if not isinstance(digest, bytes):
            raise TypeError("a written file has its hash as bytes")
        records.append(
            ImageRecord(
                traversal_id=traversal_id,
                camera=camera,
                timestamp_ns=timestamp_ns,
                out_sha256=digest.hex(),
                source_sha256=row["sha256"].hex(),
                width_px=row["width_px"],
                height_px=row["height_px"],
                detectors=configuration.detectors,
                skipped=dict(skipped.get(key, {})),
                regions=tuple(regions[key]),
                face_operator=configuration.redaction.face,
                plate_operator=configuration.redaction.plate,
                grow=configuration.redaction.grow,
                plate_region=configuration.plate_region,
            )
        )
        if redacted.mask is not None and masks is not None:
            file = masks.file(f"{camera}/{timestamp_ns}.png", encode_mask(redacted.mask))
            mask_rows.append({"camera": camera, "timestamp_ns": timestamp_ns, "kind": MASK_KIND, **file})
    # A layer of masks without rows would say that no road user is visible: none is written then.
    if masks is not None and mask_rows:
        masks.finish(MASKS, mask_rows, {_SEARCHED: searched})
    images.document(LOG, encode_log(records))
    table = pa.Table.from_pylist(image_rows, schema=IMAGES.schema)
    images.finish(IMAGES, images.pack(table) if shards else table, {_SEARCHED: searched})


def _hash_searched(rows: Mapping[ImageKey, Mapping[str, Any]], regions: Mapping[ImageKey, Sequence[Region]]) -> str:
    """Hash the images that were searched, and what was found in them."""
    found = [
        [*key, rows[key]["sha256"].hex(), [region.model_dump(mode="json") for region in regions[key]]]
        for key in sorted(rows)
    ]
    return hash_values(found)


def _open_masks(layout: Layout, traversal_id: str, configuration: Configuration, searched: str) -> LayerWriter | None:
    """Open a writer of the masks; None: an interrupted run completed them. Its masks of other images are removed."""
    layer = DerivedLayer(
        layout, traversal_id, MASKS.name, SOURCE, configuration.version, {"configuration": configuration.sha256},
        _DESCRIBED, frozenset({_SEARCHED, RECORDED, REDACTION}), _REMEDY,
    )  # fmt: skip
    manifest = read_manifest(layer.folder) if layer.exists() else None
    if manifest is not None:
        if manifest.derived_from.get(_SEARCHED) == searched:
            return None
        remove_layer(layer.folder)
    return layer.open()


def _redacted(
    store: Store,
    rows: Mapping[ImageKey, Mapping[str, Any]],
    regions: Mapping[ImageKey, Sequence[Region]],
    how: Redaction,
    workers: int,
) -> Iterator[tuple[ImageKey, RedactedImage]]:
    """Redact the images in their order, some at a time."""
    videos = VideoDecoders(store)

    def work(key: ImageKey) -> RedactedImage:
        row = rows[key]
        return redact_recorded(store, videos, row, read_recorded(store, row), regions[key], how)

    keys = iter(sorted(rows))
    with thread_pool(max(workers, 1)) as pool:
        while chunk := list(islice(keys, _AT_ONCE * max(workers, 1))):
            yield from zip(chunk, pool.map(work, chunk))
