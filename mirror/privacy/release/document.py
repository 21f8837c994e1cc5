"""``release.json``: what a release is, what was done to it, and what was withdrawn from it."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field

from mirror.schema.documents import Document

DOCUMENT: Final = "release.json"
DATASHEET: Final = "DATASHEET.md"
LICENCE: Final = "LICENCE.txt"
LOG: Final = "redaction_log.jsonl"
TIMES: Final[dict[str, int]] = {"exact": 1, "hour": 3_600, "day": 86_400, "week": 604_800}
"""Grain of the clock of a release in seconds, by name."""


class Tombstone(Document):
    """A withdrawn image or traversal of a release.

    Attributes:
        item: id of a traversal, or ``traversal/camera/timestamp_ns`` of an image.
        version: version of the release from which on it is absent.
        reason: why, as stated.
    """

    item: str
    version: int
    reason: str = ""


class Release(Document):
    """``release.json`` in the folder of a release.

    Attributes:
        format: always ``mirror-release``.
        name: name of the release; its versions have the same.
        version: counts from 1; a withdrawal makes the next one.
        contact: where persons ask for the removal of an image.
        sample: number of images that persons reviewed, chosen by hash.
        reviewed_regions: number of regions in them.
        missed: number of regions that reviewers missed in them.
        withheld: number of images of the dataset that have no redacted version and were left out.
        clock: grain of the clock: the times of each drive are shifted by one amount, so that it begins at a multiple.
        trim_ends_s: traversals nearer in time than this to an end of their drive were left out.
        trimmed: number of traversals that were left out for it.
        pseudonyms: `renewed`: vehicles and drives have ids of this release; `kept`: those of the dataset.
        plate_region: region of the number plates, where it is known.
        road_maps_left_out: number of recorded road maps of the dataset; a release has none of them.
        tombstones: what was withdrawn.
    """

    format: Literal["mirror-release"] = "mirror-release"
    name: str
    version: int = Field(default=1, ge=1)
    contact: str
    sample: int = 0
    reviewed_regions: int = 0
    missed: int = 0
    withheld: int = 0
    clock: Literal["exact", "hour", "day", "week"] = "exact"
    trim_ends_s: float = 0.0
    trimmed: int = 0
    pseudonyms: Literal["renewed", "kept"] = "renewed"
    plate_region: str | None = None
    road_maps_left_out: int = 0
    tombstones: tuple[Tombstone, ...] = ()
