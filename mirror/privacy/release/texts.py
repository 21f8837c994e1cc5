"""The datasheet and the licence of a release."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

from mirror.privacy.log import ImageRecord
from mirror.privacy.release.document import Release
from mirror.privacy.release.sample import miss_bound

NO_REIDENTIFICATION: Final = "You must not try to identify a person or a vehicle"
_CLOCKS: Final = {
    "exact": "Times are those of the recording.",
    "hour": "The clock of each drive was shifted so that it begins at a full hour.",
    "day": "The clock of each drive was shifted so that it begins at midnight UTC.",
    "week": "The clock of each drive was shifted so that it begins at a full week since the Unix epoch.",
}


def datasheet(release: Release, records: Sequence[ImageRecord], traversals: int) -> str:
    """Write the datasheet: the removed content and the method, the kept content, and the review."""
    regions = Counter(f"{region.kind}, from {region.origin}" for record in records for region in record.regions)
    detectors = {one for record in records for one in record.detectors}
    skipped: Counter[str] = Counter()
    for record in records:
        skipped.update(record.skipped)
    redacted = sum(bool(record.regions) for record in records)
    lines = [
        f"# {release.name}, version {release.version}",
        "",
        f"{traversals} traversals, {len(records):,} images, of which {redacted:,} have redacted regions.",
        "",
        "## What was removed",
        "",
        "Faces and number plates in all images, by these detectors:",
        "",
        "| detector | finds | version | threshold | weights (SHA-256) |",
        "|---|---|---|---|---|",
        *(
            f"| {one.name} | {one.kind}s | {one.version} | {one.threshold:g} | `{one.weights_sha256}` |"
            for one in sorted(detectors, key=lambda one: one.name)
        ),
        "",
        f"Region of the number plates: {release.plate_region or 'not stated'}.",
        "",
        "| regions | number |",
        "|---|---|",
        *(f"| {name} | {count:,} |" for name, count in sorted(regions.items())),
        "",
        "A plate is replaced by one mean colour, a face by at most 4 x 4 mean colours.",
        "Metadata of image files was removed.",
        f"{release.withheld:,} images that could not be processed were left out.",
        *(f"Not searched: {count:,} {name}." for name, count in sorted(skipped.items())),
        "",
        "## Places and times",
        "",
        _CLOCKS[release.clock],
        (
            f"{release.trimmed} traversals within {release.trim_ends_s:g} s of an end of their drive were left out."
            if release.trim_ends_s
            else "The ends of drives were not trimmed."
        ),
        (
            "Vehicles and drives have pseudonyms of this release."
            if release.pseudonyms == "renewed"
            else "Vehicles and drives have the pseudonyms of the source dataset."
        ),
        "Driven trajectories are exact within each traversal.",
        f"Recorded road maps that were left out: {release.road_maps_left_out:,}.",
        "",
        "## Review",
        "",
        *_review_lines(release),
        "",
        "## Limits",
        "",
        "Detectors miss some faces and plates, above all small, turned and reflected ones. Faces on posters, telephone",
        "numbers and names on vehicles and shops, gait, clothing and tattoos were not removed.",
        "",
        "## Withdrawn",
        "",
        *(
            [f"- `{one.item}`, version {one.version}: {one.reason or 'no reason stated'}" for one in release.tombstones]
            or ["Nothing."]
        ),
        "",
        f"Contact for removal: {release.contact}",
        "",
    ]
    return "\n".join(lines)


def _review_lines(release: Release) -> list[str]:
    if not release.sample:
        return ["No image was reviewed by a person: nothing states how many images still show a face or plate."]
    bound = miss_bound(release.missed, release.sample)
    return [
        f"Persons reviewed {release.sample:,} images, chosen by hash, and found {release.missed} with a missed region:",
        f"with 95 % confidence at most {100.0 * bound:.2f} % of the images have one.",
    ]


def licence_text(release: Release, licence: str) -> str:
    """Return the licence of the data, with the conditions that protect the persons in it."""
    return "\n".join(
        [
            f"{release.name}, version {release.version}",
            "",
            f"Licence: {licence}",
            "",
            "Further conditions:",
            "",
            f"1. {NO_REIDENTIFICATION}, to undo a redaction, or to link",
            "   this data with other data for that purpose.",
            "2. You must delete what a later version of this release withdraws, and pass this condition on.",
            f"3. Whoever finds a person or a vehicle that can be identified reports it to {release.contact}.",
            "",
        ]
    )
