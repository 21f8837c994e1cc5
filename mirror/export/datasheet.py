"""The datasheet of a published dataset, as the README.md that dataset hosts show (Gebru et al., "Datasheets", 2021)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Final

from mirror.dataset.dataset import Dataset
from mirror.dataset.statistics import compute_statistics
from mirror.schema.bundle import Bundle

_MOST_SAMPLES: Final = 4


def write_datasheet(
    dataset: Dataset, bundle: Bundle, *, name: str, contact: str | None, images: Sequence[str] = ()
) -> str:
    """Write the text of a datasheet, with the YAML header of a dataset card.

    Args:
        dataset: the complete dataset.
        bundle: the published part.
        name: title of the dataset.
        contact: where to ask for the removal of data; None: the sheet asks the publisher to add it.
        images: paths of the published images below the bundle, of which the sheet shows one of each condition.
    """
    totals = compute_statistics(dataset)
    published = len([path for path in bundle.files if path.endswith((".jpg", ".jpeg", ".png"))])
    size = sum(entry.bytes for entry in bundle.files.values())
    header = [
        "---",
        f"pretty_name: {name}",
        f"license: {'other' if ' ' in bundle.licence else bundle.licence.lower()}",
        "task_categories: [image-to-3d, image-to-image]",
        "tags: [autonomous-driving, multi-traversal, novel-view-synthesis]",
        f"size_categories: ['{_size_category(published)}']",
        "viewer: false",
        "---",
    ]
    conditions = ", ".join(
        f"{condition.traversals} {condition.light}, {condition.weather}" for condition in totals.conditions
    )
    samples = _show_samples(dataset, images)
    sections = {
        **({"Sample images": samples} if samples else {}),
        "Composition": [
            f"{totals.traversals} traversals of {len(totals.scenes)} scenes, from {totals.drives} drives of"
            f" {totals.vehicles} vehicles, {totals.row.hours:.2f} hours. Traversals by condition: {conditions}.",
            f"{published:,} images and tables of poses, calibrations and boxes, {size / 1e6:,.1f} MB.",
        ],
        "Withheld data": [
            f"{len(bundle.withheld):,} images are withheld: those of held-out traversals of split `{bundle.split}`, and"
            f" those scored by {', '.join(f'`{protocol}`' for protocol in bundle.protocols)}. Layers"
            " of depth and points, which could contain them, are withheld too. The organiser has them.",
        ],
        "Collection and cleaning": [
            "Recordings of instrumented vehicles were cut into traversals of regions of interest. `drives/*/drive.json`"
            " states the source, the cleaning and the dropped rows of each drive, `drives/*/passes.parquet` every"
            " accepted and refused pass.",
        ],
        "Use": [
            "```sh",
            f"mirror dataset fetch URL --out {_folder_name(name)}",
            f"mirror reconstruct {_folder_name(name)} --split {bundle.split} --out runs/mine",
            "```",
            "docs/benchmark.md of MIRROR describes how to submit. Do not identify persons or vehicles in the images.",
        ],
        "Licence": [f"{bundle.licence}; see the file LICENSE."],
        "Contact": [contact or "Ask the publisher of this copy for the removal of data."],
        "Verification": [
            f"`{bundle.format}` {bundle.version}: bundle.json lists {len(bundle.files):,} files with size and SHA-256;"
            f" `mirror dataset fetch` verifies them. Hash of the data of the split: `{bundle.dataset_hash}`.",
        ],
    }
    return "\n".join(
        [*header, "", f"# {name}", "", *(line for title, lines in sections.items() for line in _section(title, lines))]
    )


def _show_samples(dataset: Dataset, images: Sequence[str]) -> list[str]:
    """Arrange one published image of each condition, of a front camera in the middle of a traversal, as a table."""
    by_traversal: dict[str, list[str]] = {}
    for path in sorted(images):
        parts = PurePosixPath(path).parts
        if len(parts) > 2 and parts[0] == "traversals":
            by_traversal.setdefault(parts[1], []).append(path)
    shown: dict[str, str] = {}
    for row in dataset.table("traversals", ["traversal_id", "light", "weather"]).to_pylist():
        own = by_traversal.get(row["traversal_id"], [])
        front = [path for path in own if PurePosixPath(path).parent.name.startswith("front")] or own
        camera = PurePosixPath(front[0]).parent if front else None
        of_camera = [path for path in front if PurePosixPath(path).parent == camera]
        if of_camera:
            shown.setdefault(f"{row['light']}, {row['weather']}", of_camera[len(of_camera) // 2])
    if not shown:
        return []
    chosen = sorted(shown.items())[:_MOST_SAMPLES]
    cells = [f"![{words}](<{path}>)" for words, path in chosen]
    rows = [[words for words, _ in chosen], ["---"] * len(chosen), cells]
    return [f"| {' | '.join(row)} |" for row in rows]


def _section(title: str, lines: Sequence[str]) -> list[str]:
    return [f"## {title}", "", *lines, ""]


def _folder_name(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name.lower()).strip("-") or "dataset"


def _size_category(images: int) -> str:
    for limit, label in ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M")):
        if images < limit:
            return label
    return "1M<n<10M"
