"""What was removed from the images of a dataset, counted from the logs of its redactions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.redaction import REDACTION, newest_redaction
from mirror.dataset.taken_down import read_take_downs
from mirror.privacy.log import LOG, ImageRecord, read_log
from mirror.privacy.regions import KINDS, Kind, Origin, Region, grown_box, region_mask
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES

_SURROUNDINGS: Final = 3.0
"""An example is so many times as wide and as high as its region."""
_LEAST_PX: Final = 64


@dataclass(frozen=True)
class RedactionSummary:
    """Counts of the regions that a redaction layer removed.

    Attributes:
        images: number of images that were searched.
        regions: number of removed regions by origin, by kind.
        covered_share: share of the pixels of all images that the regions cover, as they were enlarged.
    """

    images: int
    regions: Mapping[str, Mapping[str, int]]
    covered_share: float


def summarize_redactions(dataset: Dataset) -> RedactionSummary | None:
    """Count the regions that the newest redaction of each traversal removed from a view's images.

    Returns:
        The counts; None: there is no log, or the dataset is not a local folder.

    Raises:
        SchemaError: a log is broken.
    """
    if dataset.store.folder is None:
        return None
    cameras = set(dataset.cameras())
    records = [record for record in _read_logs(dataset) if record.camera in cameras]
    if not records:
        return None
    found = [(region.kind, region.origin) for record in records for region in record.regions]
    regions: dict[str, dict[str, int]] = {
        kind: {origin: found.count((kind, origin)) for origin in get_args(Origin)} for kind in KINDS
    }
    return RedactionSummary(len(records), regions, _covered_share(records))


@dataclass(frozen=True, eq=False)
class RemovalExample:
    """A region and its surroundings, in the recorded and in the redacted image.

    Attributes:
        kind: what the region shows.
        before: (H, W, 3) RGB, recorded: it identifies a person or a vehicle.
        after: the same pixels of the redacted image.
    """

    kind: Kind
    before: UInt8
    after: UInt8


def read_examples(dataset: Dataset, count: int = 4) -> list[RemovalExample]:
    """Read the largest removed regions of a view, before and after, each of another image, faces and plates in turns.

    Args:
        dataset: a dataset with its recorded images; of a release there are no examples.
        count: largest number of examples.

    Raises:
        DatasetError: an image cannot be read.
        SchemaError: a log or a table is broken.
    """
    from mirror.dataset.images.video_decoders import VideoDecoders

    if dataset.store.folder is None:
        return []
    cameras = set(dataset.cameras())
    records = [one for one in _read_logs(dataset) if one.camera in cameras and one.source_sha256 is not None]
    by_kind: list[list[tuple[ImageRecord, Region]]] = [_largest_regions(records, kind) for kind in KINDS]
    turns = [(place, number, pair) for number, own in enumerate(by_kind) for place, pair in enumerate(own)]
    chosen = [pair for _, _, pair in sorted(turns, key=lambda turn: turn[:2])[:count]]
    videos = VideoDecoders(dataset.store)
    return [_read_example(dataset, videos, record, region) for record, region in chosen]


def _largest_regions(records: Sequence[ImageRecord], kind: Kind) -> list[tuple[ImageRecord, Region]]:
    """Return the largest region of a kind in each image, the largest of all first."""

    def area(region: Region) -> float:
        width, height = region.size_px
        return width * height

    found = [
        (record, max((region for region in record.regions if region.kind == kind), key=area))
        for record in records
        if any(region.kind == kind for region in record.regions)
    ]
    return sorted(found, key=lambda pair: (-area(pair[1]), pair[0].key))


def _read_example(dataset: Dataset, videos: Any, record: ImageRecord, region: Region) -> RemovalExample:
    from mirror.privacy.detection import decode_recorded, read_recorded

    share = max(_SURROUNDINGS, *(_LEAST_PX / size for size in region.size_px)) - 1.0
    box = grown_box(region, share, record.width_px, record.height_px) or (0, 0, record.width_px, record.height_px)
    left, top, right, bottom = box
    recorded = read_table(dataset.layout.recorded(record.traversal_id) / "images.parquet", IMAGES).to_pylist()
    redacted = dataset.where(traversal=record.traversal_id).table("images").to_pylist()
    crops = []
    for rows in (recorded, redacted):
        row = next(row for row in rows if (row["camera"], row["timestamp_ns"]) == record.key[1:])
        pixels = decode_recorded(dataset.store, videos, row, read_recorded(dataset.store, row))
        crops.append(np.ascontiguousarray(pixels[top:bottom, left:right]))
    return RemovalExample(region.kind, *crops)


def _read_logs(dataset: Dataset) -> list[ImageRecord]:
    """The records of a view: of the layers of its traversals, or of a release."""
    layout, traversals = dataset.layout, dataset.traversals()
    logs = [layout.root / LOG]
    for name in traversals:
        newest = newest_redaction(layout.layers(name))
        if newest is not None:
            logs.append(layout.layer(name, REDACTION, *newest) / LOG)
    records = [record for log in logs if log.is_file() for record in read_log(log)]
    chosen, gone = set(traversals), {one.key for one in read_take_downs(dataset.store).images}
    return [record for record in records if record.traversal_id in chosen and record.key not in gone]


def _covered_share(records: Sequence[ImageRecord]) -> float:
    pixels = sum(record.width_px * record.height_px for record in records)
    covered = sum(
        int(region_mask(record.regions, record.grow, record.width_px, record.height_px).sum())
        for record in records
        if record.regions
    )
    return covered / pixels
