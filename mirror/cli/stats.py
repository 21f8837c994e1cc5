"""``mirror stats DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from mirror.dataset.statistics import Statistics

_UNBOUNDED = 160


@dataclass(frozen=True)
class Arguments:
    """What a dataset amounts to: the row of the paper's dataset table, traversals a scene, speeds, conditions."""

    dataset: tyro.conf.Positional[str]
    """The dataset's folder or URL."""
    plots: Path | None = None
    """Write plots (PNG) into this folder."""
    json: bool = False
    """Print the statistics as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror stats")

    from mirror.dataset import open as open_dataset
    from mirror.dataset.statistics import compute_statistics

    found = compute_statistics(open_dataset(arguments.dataset))
    files: list[Path] = []
    if arguments.plots is not None:
        from mirror.view.plots import write_plots

        files = write_plots(found, arguments.plots)
    if arguments.json:
        print(json.dumps({"dataset": arguments.dataset, **found.to_dict(), "plots": [str(file) for file in files]}))
        return ExitCode.DONE
    _print(found)
    for file in files:
        print(f"plot: {file}")
    return ExitCode.DONE


def _print(found: Statistics) -> None:
    from mirror.cli.output import plain_console

    console = plain_console()
    if not console.is_terminal:
        # A file or a pipe has no edge to wrap at.
        console.width = _UNBOUNDED
    row = found.row
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
        ("scene", "city", "type", "traversals", "drives", "min", "pictures", "light"),
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
            for scene in found.scenes
        ],
    )
    _table(
        console,
        "conditions",
        ("light", "weather", "traversals", "min"),
        [(one.light, one.weather, one.traversals, f"{60 * one.hours:.1f}") for one in found.conditions],
    )
    if found.speed is not None:
        percents = found.speed.quantiles_mps.items()
        _table(
            console,
            "speed (m/s, weighted by time)",
            ("mean", *(f"{percent} %" for percent, _ in percents), "standing"),
            [(f"{found.speed.mean_mps:.1f}", *(f"{v:.1f}" for _, v in percents), f"{found.speed.standing:.0%}")],
        )
    types = ", ".join(f"{name} {count}" for name, count in found.vehicle_types.items())
    refused = ", ".join(f"{rule} {count}" for rule, count in found.refused.items()) or "none"
    console.print()
    console.print(
        f"traversals {found.traversals}, drives {found.drives}, vehicles {found.vehicles}; by type: {types or '--'}"
    )
    console.print(f"refused passes: {refused}")
    console.print(
        f"{found.images:,} pictures ({found.image_bytes / 1e6:,.1f} MB) in {found.frames:,} frames,"
        f" {found.camera_hours:.2f} camera hours; cities: {', '.join(row.cities) or 'not stated'}"
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
