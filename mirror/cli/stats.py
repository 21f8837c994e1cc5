"""``mirror stats DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from mirror.dataset.statistics import Statistics

_PIPE_WIDTH = 160
_EXAMPLES = ("mirror stats demo/dataset", "mirror stats demo/dataset --plots plots --json")


@dataclass(frozen=True)
class Arguments:
    """Print the row of the paper's dataset table, and traversals per scene, speeds and conditions."""

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    plots: Annotated[Path | None, help_text(default="no plots", metavar="FOLDER")] = None
    """Folder for plots (PNG)."""
    json: bool = False
    """Print the statistics as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror stats", examples=_EXAMPLES)

    from mirror.dataset import open as open_dataset
    from mirror.dataset.statistics import compute_statistics

    totals = compute_statistics(open_dataset(arguments.dataset))
    files: list[Path] = []
    if arguments.plots is not None:
        from mirror.view.plots import write_plots

        files = write_plots(totals, arguments.plots)
    if arguments.json:
        print(json.dumps({"dataset": arguments.dataset, **totals.to_dict(), "plots": [str(file) for file in files]}))
        return ExitCode.DONE
    _print(totals)
    for file in files:
        print(f"plot: {file}")
    return ExitCode.DONE


def _print(totals: Statistics) -> None:
    from mirror.cli.output import plain_console

    console = plain_console()
    if not console.is_terminal:
        # A file or a pipe has no width.
        console.width = _PIPE_WIDTH
    row = totals.row
    _table(
        console,
        None,
        ("multi-trav.", "km2", "scenes", "1e-3 km2/scene", "cities", "hours", "cameras", "light"),
        [
            (
                "yes" if row.multi_traversal else "no",
                f"{row.area_km2:.3f}",
                row.scenes,
                f"{1e3 * row.area_per_scene_km2:.1f}",
                len(row.cities) or "--",
                f"{row.hours:.2f}",
                row.cameras,
                row.conditions,
            )
        ],
    )
    _table(
        console,
        "scenes",
        ("scene", "city", "type", "traversals", "drives", "min", "images", "light"),
        [
            (
                scene.scene_id,
                scene.city or "--",
                scene.scene_type or "--",
                scene.traversals,
                scene.drives,
                f"{60 * scene.hours:.1f}",
                f"{scene.images:,}",
                ", ".join(f"{name} {count}" for name, count in scene.light.items()),
            )
            for scene in totals.scenes
        ],
    )
    _table(
        console,
        "conditions",
        ("light", "weather", "traversals", "min"),
        [(row.light, row.weather, row.traversals, f"{60 * row.hours:.1f}") for row in totals.conditions],
    )
    if totals.categories:
        _table(
            console,
            "boxes",
            ("layer", "category", "boxes", "objects", "mean score"),
            [
                (
                    item.layer,
                    item.category,
                    f"{item.boxes:,}",
                    f"{item.objects:,}",
                    "--" if item.mean_score is None else f"{item.mean_score:.2f}",
                )
                for item in totals.categories
            ],
        )
    if totals.speed is not None:
        percents = totals.speed.quantiles_mps.items()
        _table(
            console,
            "speed (m/s, weighted by time)",
            ("mean", *(f"{percent} %" for percent, _ in percents), "standing"),
            [(f"{totals.speed.mean_mps:.1f}", *(f"{v:.1f}" for _, v in percents), f"{totals.speed.standing:.0%}")],
        )
    types = ", ".join(f"{name} {count}" for name, count in totals.vehicle_types.items())
    refused = ", ".join(f"{rule} {count}" for rule, count in totals.refused.items()) or "none"
    console.print()
    console.print(
        f"traversals {totals.traversals}, drives {totals.drives}, vehicles {totals.vehicles}; by type: {types or '--'}"
    )
    console.print(f"refused passes: {refused}")
    console.print(
        f"{totals.images:,} images ({totals.image_bytes / 1e6:,.1f} MB) in {totals.frames:,} frames,"
        f" {totals.camera_hours:.2f} camera hours; cities: {', '.join(row.cities) or 'not stated'}"
    )


def _table(console: object, title: str | None, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for column, name in enumerate(header):
        numeric = bool(rows) and all(str(row[column])[:1].isdigit() for row in rows)
        table.add_column(name, justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    if title is not None:
        console.print()  # type: ignore[attr-defined]
    console.print(table)  # type: ignore[attr-defined]
