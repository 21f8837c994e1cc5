"""The layers of a de-identified traversal: redacted images with their log, and masks of what was replaced."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

from mirror.dataset.images.binary_mask import encode_mask
from mirror.dataset.images.video_decoders import VideoDecoders
from mirror.dataset.layer_writer import LayerWriter, remove_layer
from mirror.dataset.layout import Layout, read_manifest
from mirror.dataset.redaction import REDACTION
from mirror.dataset.store import Store
from mirror.errors import DatasetError
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


@dataclass(frozen=True)
class Configuration:
    """What the layers of one version have in common.

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


def write_layers(
    layout: Layout,
    traversal_id: str,
    rows: Mapping[ImageKey, Mapping[str, Any]],
    regions: Mapping[ImageKey, Sequence[Region]],
    skipped: Mapping[ImageKey, Mapping[str, int]],
    configuration: Configuration,
    *,
    workers: int,
) -> None:
    """Write the layer of masks, then that of redacted images, which is complete with its log or absent.

    A few images are in memory at a time.

    Args:
        layout: the dataset; the caller holds its writer lock.
        traversal_id: the traversal.
        rows: rows of the recorded images table, by image, with the hashes of the bytes that were searched.
        regions: what is removed, by image.
        skipped: tiles that were not searched, by image.
        configuration: detectors and operators.
        workers: number of threads.

    Raises:
        DatasetError: an image cannot be read or written; a layer of another configuration exists.
    """
    store = Store(layout.root)
    derived_from = {"configuration": configuration.sha256, "searched": _hash_searched(rows, regions)}
    images = LayerWriter(layout, traversal_id, REDACTION, SOURCE, configuration.version)
    masks = _mask_writer(layout, traversal_id, configuration, derived_from)
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
        masks.finish(MASKS, mask_rows, derived_from)
    images.document(LOG, encode_log(records))
    images.finish(IMAGES, image_rows, derived_from)


def _hash_searched(rows: Mapping[ImageKey, Mapping[str, Any]], regions: Mapping[ImageKey, Sequence[Region]]) -> str:
    """Hash the images that were searched, and what was found in them."""
    found = [
        [*key, rows[key]["sha256"].hex(), [region.model_dump(mode="json") for region in regions[key]]]
        for key in sorted(rows)
    ]
    return hash_values(found)


def _mask_writer(
    layout: Layout, traversal_id: str, configuration: Configuration, derived_from: Mapping[str, str]
) -> LayerWriter | None:
    """A writer of the masks; None: an interrupted run completed them. Its masks of other images are removed."""
    folder = layout.layer(traversal_id, MASKS.name, SOURCE, configuration.version)
    manifest = read_manifest(folder)
    if manifest is not None:
        if manifest.derived_from.get("configuration") != configuration.sha256:
            raise DatasetError(
                "the layer of masks was made with other options", file=folder,
                expected="the same detectors, region of number plates and other options",
                remedy="write another version: --version NAME",
            )  # fmt: skip
        if derived_from.items() <= manifest.derived_from.items():
            return None
        remove_layer(folder)
    return LayerWriter(layout, traversal_id, MASKS.name, SOURCE, configuration.version)


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


def layer_folder(layout: Layout, traversal_id: str, version: str) -> Path:
    """The folder of the redacted images of a version."""
    return layout.layer(traversal_id, REDACTION, SOURCE, version)
