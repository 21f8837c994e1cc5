"""Figures of a dataset for print: maps, coverage, cameras, privacy, and one place in all traversals (matplotlib)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.dataset.dataset import Dataset
from mirror.dataset.statistics import compute_statistics
from mirror.dataset.times import longitude_of, utc_and_solar
from mirror.view.cameras_figure import cameras_figure
from mirror.view.images import choose_passages, condition_order, frame_of, same_place
from mirror.view.plots import (
    LIGHT_COLOURS,
    conditions_figure,
    new_axes,
    new_figure,
    speed_figure,
    traversals_figure,
    whole_numbers,
)
from mirror.view.privacy_figure import RemovedRegions, privacy_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CELL_M: Final = 10.0
"""Side of a cell of the coverage."""

FIGURES: Final = (
    "traversals", "conditions", "speed", "categories", "map", "coverage", "place", "cameras", "privacy",
)  # fmt: skip

_MOST_SCENES: Final = 12
_MOST_PASSAGES: Final = 24
_MOST_CATEGORIES: Final = 16
_COLUMNS: Final = 4


def draw_figures(
    dataset: Dataset, names: Sequence[str], removed: RemovedRegions | None = None
) -> Iterator[tuple[str, Figure]]:
    """Draw figures one after the other; figures without data are left out.

    Args:
        dataset: the dataset or a view of it.
        names: names among `FIGURES`.
        removed: what was removed from redacted images, for the figure ``privacy``.

    Yields:
        Name and figure.

    Raises:
        UsageError: matplotlib is not installed.
    """
    statistics = compute_statistics(dataset)
    has_traversals = statistics.traversals > 0
    drawers = {
        "traversals": lambda: traversals_figure(statistics) if has_traversals else None,
        "conditions": lambda: conditions_figure(statistics) if has_traversals else None,
        "speed": lambda: None if statistics.speed is None else speed_figure(statistics.speed),
        "categories": lambda: categories_figure([(row.category, row.boxes) for row in statistics.categories]),
        "map": lambda: map_figure(dataset),
        "coverage": lambda: coverage_figure(dataset),
        "place": lambda: place_figure(dataset),
        "cameras": lambda: cameras_figure(dataset),
        "privacy": lambda: privacy_figure(dataset, removed),
    }
    for name in names:
        figure = drawers[name]()
        if figure is not None:
            yield name, figure


def driven_lines(dataset: Dataset, scene: Mapping[str, Any]) -> list[tuple[Mapping[str, Any], Float64]]:
    """Return the line (N, 2) of each traversal of a scene from entry to exit, in metres from the region's centre."""
    centre = np.array([scene["x_m"], scene["y_m"]]) if scene["frame"] is not None else np.zeros(2)
    lines = []
    view = dataset.where(scene=scene["scene_id"])
    for row in view.table("traversals").to_pylist():
        poses = view.where(traversal=row["traversal_id"]).table("ego_poses", ["timestamp_ns", "tx_m", "ty_m"])
        stamps, x, y = (column.to_numpy() for column in poses.columns)
        inside = (stamps >= row["entry_ns"]) & (stamps <= row["exit_ns"])
        lines.append((row, np.stack([x[inside], y[inside]], axis=1) - centre))
    return lines


def count_coverage(lines: Sequence[Float64], radius_m: float, cell_m: float = CELL_M) -> Int64:
    """Count the traversals through each cell of a scene.

    Args:
        lines: the lines (N, 2) of the traversals, relative to the region's centre.
        radius_m: radius of the region; the cells cover the square around it.
        cell_m: side of a cell.

    Returns:
        (rows, columns), row 0 in the south; segments of a line are sampled ten times a cell.
    """
    count = 2 * int(np.ceil(radius_m / cell_m))
    cells = np.zeros((count, count), np.int64)
    for line in lines:
        if not len(line):
            continue
        steps = np.hypot(*np.diff(line, axis=0).T) if len(line) > 1 else np.zeros(0)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        dense = np.arange(0.0, along[-1] + cell_m / 10.0, cell_m / 10.0)
        points = np.stack([np.interp(dense, along, line[:, axis]) for axis in range(2)], axis=1)
        places = np.floor(points / cell_m).astype(np.int64) + count // 2
        inside = ((places >= 0) & (places < count)).all(axis=1)
        column, row = np.unique(places[inside], axis=0).T
        cells[row, column] += 1
    return cells


def map_figure(dataset: Dataset) -> Figure | None:
    """Plot the driven lines of the scenes with the most traversals, coloured by light."""
    scenes = _busiest_scenes(dataset)
    if not scenes:
        return None
    figure, panels = _panels(len(scenes), 3.4)
    lights = set()
    for axes, scene in zip(panels, scenes):
        _prepare_map(axes, scene)
        for row, line in driven_lines(dataset, scene):
            colour = LIGHT_COLOURS.get(row["light"], LIGHT_COLOURS["unknown"])
            lights.add(row["light"])
            axes.plot(*line.T, color=colour, linewidth=0.9, alpha=0.8)
            if len(line):
                axes.plot(*line[0], marker="o", color=colour, markersize=2.5)
    for light in (name for name in LIGHT_COLOURS if name in lights):
        panels[0].plot([], [], color=LIGHT_COLOURS[light], label=light)
    figure.legend(loc="outside lower center", ncols=len(lights), frameon=False)
    figure.suptitle(f"Traversals by light; dots are entries{_of_all(dataset, scenes)}", fontsize=10)
    return figure


def coverage_figure(dataset: Dataset) -> Figure | None:
    """Plot the number of traversals in each cell of 10 m of the scenes with the most traversals."""
    scenes = _busiest_scenes(dataset)
    if not scenes:
        return None
    figure, panels = _panels(len(scenes), 3.4)
    cells = [count_coverage([line for _, line in driven_lines(dataset, scene)], scene["radius_m"]) for scene in scenes]
    most = max(int(count.max()) for count in cells) or 1
    drawn: Any = None
    for axes, scene, count in zip(panels, scenes, cells):
        _prepare_map(axes, scene)
        reach = count.shape[0] / 2 * CELL_M
        shown = np.ma.masked_equal(count, 0)
        drawn = axes.imshow(
            shown, origin="lower", extent=(-reach, reach, -reach, reach), cmap="viridis", vmin=0.5, vmax=most + 0.5,
            interpolation="nearest", zorder=2,
        )  # fmt: skip
    bar = figure.colorbar(drawn, ax=panels, shrink=0.7, label=f"traversals per {CELL_M:g} m cell")
    bar.locator = whole_numbers()
    bar.update_ticks()
    figure.suptitle(f"Coverage{_of_all(dataset, scenes)}", fontsize=10)
    return figure


def categories_figure(counts: Sequence[tuple[str, int]]) -> Figure | None:
    """Plot the number of boxes of each category, most frequent first."""
    totals: dict[str, int] = {}
    for name, count in counts:
        totals[name] = totals.get(name, 0) + count
    rows = sorted(totals.items(), key=lambda item: -item[1])[:_MOST_CATEGORIES]
    if not rows:
        return None
    figure = new_figure(6.0, 1.2 + 0.28 * len(rows))
    axes = new_axes(figure)
    bars = axes.barh([name for name, _ in rows], [count for _, count in rows], color="#4c78a8", height=0.7)
    axes.bar_label(bars, fmt="{:,.0f}", padding=3, fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.set_xlabel("boxes")
    axes.set_title("Boxes by category", fontsize=10)
    return figure


def place_figure(dataset: Dataset) -> Figure | None:
    """Show one place of the scene with the most traversals, in every traversal that passes the place."""
    for scene in _busiest_scenes(dataset):
        rows = dataset.where(scene=scene["scene_id"]).table("traversals").to_pylist()
        passages = choose_passages(same_place(dataset, rows), _MOST_PASSAGES)
        if len(passages) < 2:
            continue
        passages.sort(key=lambda item: condition_order(item.traversal["light"], item.traversal["weather"]))
        figure, panels = _panels(len(passages), 1.9, width=2.6)
        for axes, item in zip(panels, passages):
            row = item.traversal
            frame = frame_of(dataset, row["traversal_id"], item.frame_index)
            # A vehicle that drives the other way looks at the place backwards.
            ahead = next(iter(frame.images))
            camera = ahead if item.is_same_direction or "rear" not in frame.images else "rear"
            axes.imshow(frame.images[camera].decode())
            axes.set_axis_off()
            about = f"{row['light']}, {row['weather']}, {camera}"
            time = utc_and_solar(frame.timestamp_ns, longitude_of(row))
            axes.set_title(f"{about}\n{time}\n{item.distance_m:.1f} m away", fontsize=6.5)
        figure.suptitle(f"One place of {scene['scene_id']} in {len(passages)} traversals", fontsize=10)
        return figure
    return None


def _prepare_map(axes: Any, scene: Mapping[str, Any]) -> None:
    from matplotlib.patches import Circle

    radius = scene["radius_m"]
    axes.add_patch(Circle((0.0, 0.0), radius, fill=False, linestyle=":", color="#888888", linewidth=0.8))
    axes.set_aspect("equal")
    axes.set_xlim(-1.05 * radius, 1.05 * radius)
    axes.set_ylim(-1.05 * radius, 1.05 * radius)
    axes.tick_params(labelsize=7)
    directions = ("x (m)", "y (m)") if scene["frame"] is not None else ("east (m)", "north (m)")
    axes.set_xlabel(directions[0], fontsize=7)
    axes.set_ylabel(directions[1], fontsize=7)
    axes.set_title(f"{scene['scene_id']}: {scene['traversals']} traversals", fontsize=8)


def _busiest_scenes(dataset: Dataset) -> list[Mapping[str, Any]]:
    scenes = [scene for scene in dataset.table("scenes").to_pylist() if scene["traversals"]]
    return sorted(scenes, key=lambda scene: (-scene["traversals"], scene["scene_id"]))[:_MOST_SCENES]


def _of_all(dataset: Dataset, shown: Sequence[object]) -> str:
    scenes = dataset.count("scenes")
    return f" ({len(shown)} of {scenes} scenes, those with the most traversals)" if scenes > len(shown) else ""


def _panels(count: int, height: float, *, width: float = 3.4) -> tuple[Figure, list[Any]]:
    """A figure with panels in rows of four."""
    columns = min(count, _COLUMNS)
    rows = -(-count // columns)
    figure = new_figure(max(width * columns, 4.2), height * rows + 0.7)
    grid: Any = figure.subplots(rows, columns, squeeze=False)
    panels = grid.ravel().tolist()
    for axes in panels[count:]:
        axes.set_axis_off()
    return figure, panels[:count]
