"""What was removed from the images of a dataset, counted from the logs of its redactions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from mirror.dataset.dataset import Dataset
from mirror.dataset.redaction import REDACTION, newest_redaction
from mirror.privacy.log import LOG, ImageRecord, read_log
from mirror.privacy.regions import KINDS, Origin, region_mask


@dataclass(frozen=True)
class RedactionSummary:
    """What was removed.

    Attributes:
        images: number of images that were searched.
        regions: number of removed regions by origin, by kind.
        covered_share: share of the pixels of all images that the regions cover, as they were enlarged.
    """

    images: int
    regions: Mapping[str, Mapping[str, int]]
    covered_share: float


def summarize_redactions(dataset: Dataset) -> RedactionSummary | None:
    """Count what the newest redaction of each traversal removed from the images of a view.

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


def _read_logs(dataset: Dataset) -> list[ImageRecord]:
    """The records of a view: of the layers of its traversals, or of a release."""
    layout, traversals = dataset.layout, dataset.traversals()
    logs = [layout.root / LOG]
    for name in traversals:
        newest = newest_redaction(layout.layers(name))
        if newest is not None:
            logs.append(layout.layer(name, REDACTION, *newest) / LOG)
    records = [record for log in logs if log.is_file() for record in read_log(log)]
    chosen = set(traversals)
    return [record for record in records if record.traversal_id in chosen]


def _covered_share(records: Sequence[ImageRecord]) -> float:
    pixels = sum(record.width_px * record.height_px for record in records)
    covered = sum(
        int(region_mask(record.regions, record.grow, record.width_px, record.height_px).sum())
        for record in records
        if record.regions
    )
    return covered / pixels
