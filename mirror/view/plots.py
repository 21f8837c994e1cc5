"""Plots of a dataset's statistics (matplotlib, extra ``view``)."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64
from mirror.dataset.statistics import SceneRow, Speed, Statistics
from mirror.errors import UsageError
from mirror.installation import install_command
from mirror.schema.files import write_bytes
from mirror.schema.folders import FolderKind, require_output_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

LIGHT_COLOURS: Final = {"day": "#f2b134", "dusk": "#c8553d", "night": "#2b3a67", "unknown": "#9aa0a6"}
_INK, _GRID = "#333333", "#dddddd"
_MAX_SCENES = 50
_NAMES: Final = ("traversals", "conditions", "speed")
_KMH = 3.6


def write_plots(statistics: Statistics, folder: Path) -> list[Path]:
    """Write the plots as PNG files: traversals by scene, speeds, conditions.

    Args:
        statistics: statistics of a dataset or of a view.
        folder: folder of the plots, created if necessary; earlier plots are replaced.

    Returns:
        The written files; a plot without data is left out.

    Raises:
        UsageError: matplotlib is not installed, or the folder holds other files.
        DatasetError: the folder cannot be written.
    """
    _require_plot_folder(folder)
    figures: dict[str, Figure] = {}
    if any(scene.traversals for scene in statistics.scenes):
        figures["traversals"] = traversals_figure(statistics)
        figures["conditions"] = conditions_figure(statistics)
    if statistics.speed is not None:
        figures["speed"] = speed_figure(statistics.speed)
    files = []
    for name, figure in figures.items():
        file = folder / f"{name}.png"
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=150)
        write_bytes(file, buffer.getvalue())
        files.append(file)
    return files


def _require_plot_folder(folder: Path) -> None:
    if require_output_folder(folder, FolderKind.OTHER, place="--plots") is not None:
        others = sorted({path.name for path in folder.iterdir()} - {f"{name}.png" for name in _NAMES})
        if others:
            raise UsageError(
                f"it holds {others[0]}, which is not a plot of this command: nothing was written",
                file=folder, place="--plots", expected="a new or an empty folder, or one with earlier plots",
                remedy="name another folder with --plots",
            )  # fmt: skip


def traversals_figure(statistics: Statistics) -> Figure:
    """Plot the traversals of each scene as bars, divided by light; at most the 50 scenes with the most traversals."""
    scenes = sorted(statistics.scenes, key=lambda scene: (-scene.traversals, scene.scene_id))
    shown = scenes[:_MAX_SCENES]
    figure = new_figure(7.0, 1.4 + 0.28 * len(shown))
    axes = new_axes(figure)
    left = [0] * len(shown)
    for light, colour in LIGHT_COLOURS.items():
        counts = [scene.light.get(light, 0) for scene in shown]
        if any(counts):
            axes.barh(range(len(shown)), counts, left=left, color=colour, label=light, height=0.72)
            left = [start + count for start, count in zip(left, counts)]
    axes.set_yticks(range(len(shown)), [_scene_name(scene) for scene in shown])
    axes.invert_yaxis()
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.xaxis.set_major_locator(whole_numbers())
    axes.set_xlabel("traversals")
    more = f" (the {len(shown)} with the most of {len(scenes)})" if len(scenes) > len(shown) else ""
    title = f"{_number(statistics.traversals, 'traversal')} of {_number(statistics.row.scenes, 'scene')}{more}"
    axes.set_title(title)
    axes.grid(axis="x", color=_GRID, linewidth=0.8)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    return figure


def speed_figure(speed: Speed) -> Figure:
    """Plot the share of time at each speed, in m/s with km/h above."""
    figure = new_figure(7.0, 3.6)
    axes = new_axes(figure)
    total = sum(speed.hours)
    share = [100 * hours / total for hours in speed.hours]
    width = speed.edges_mps[1] - speed.edges_mps[0]
    last = max(index for index, value in enumerate(share) if value > 0)
    count = min(last + 2, len(share))
    middles = [edge + width / 2 for edge in speed.edges_mps[:count]]
    axes.bar(middles, share[:count], width=0.92 * width, color="#4c78a8")
    axes.set_xlim(0, speed.edges_mps[count])
    axes.axvline(speed.quantiles_mps[50], color=_INK, linewidth=1.2, linestyle="--")
    axes.set_xlabel("speed (m/s)")
    axes.set_ylabel("share of time (%)")
    axes.grid(axis="y", color=_GRID, linewidth=0.8)
    kmh = axes.secondary_xaxis("top", functions=(_to_kmh, _from_kmh))
    kmh.set_xlabel("km/h")
    title = (
        f"{_time(total)} driven, {speed.standing:.0%} of it standing; dashed: median {speed.quantiles_mps[50]:.1f} m/s"
    )
    axes.set_title(title)
    return figure


def conditions_figure(statistics: Statistics) -> Figure:
    """Return the hours and traversals of each light and weather, as a table whose cells are shaded by hours."""
    lights = list(dict.fromkeys(condition.light for condition in statistics.conditions))
    weathers = list(dict.fromkeys(condition.weather for condition in statistics.conditions))
    weathers = sorted(weathers, key=("clear", "clouds", "rain", "snow", "fog", "unknown").index)
    hours = [[0.0] * len(weathers) for _ in lights]
    for condition in statistics.conditions:
        hours[lights.index(condition.light)][weathers.index(condition.weather)] = condition.hours
    figure = new_figure(2.4 + 1.35 * len(weathers), 1.5 + 0.75 * len(lights))
    axes = new_axes(figure)
    most = max(max(row) for row in hours)
    axes.imshow(hours, cmap="Blues", vmin=0.0, vmax=1.3 * most, aspect="auto")
    for condition in statistics.conditions:
        row, column = lights.index(condition.light), weathers.index(condition.weather)
        text = f"{_time(condition.hours)}\n{_number(condition.traversals, 'traversal')}"
        colour = "white" if condition.hours > 0.8 * most else _INK
        axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=9)
    empty = [(row, column) for row in range(len(lights)) for column in range(len(weathers)) if not hours[row][column]]
    for row, column in empty:
        axes.text(column, row, "none", ha="center", va="center", color="#999999", fontsize=9)
    axes.set_xticks(range(len(weathers)), weathers)
    axes.set_yticks(range(len(lights)), lights)
    axes.set_xlabel("weather")
    axes.set_ylabel("light")
    axes.tick_params(length=0)
    axes.set_title("Conditions")
    return figure


def _scene_name(scene: SceneRow) -> str:
    return f"{scene.scene_id} ({scene.city})" if scene.city else scene.scene_id


def _time(hours: float) -> str:
    if hours >= 1:
        return f"{hours:.2f} h"
    return f"{60 * hours:.1f} min" if 60 * hours >= 1 else f"{3600 * hours:.1f} s"


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _to_kmh(mps: npt.ArrayLike) -> Float64:
    return np.asarray(mps, np.float64) * _KMH


def _from_kmh(kmh: npt.ArrayLike) -> Float64:
    return np.asarray(kmh, np.float64) / _KMH


def whole_numbers() -> MaxNLocator:
    """Return a locator that puts axis ticks at whole numbers."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(integer=True)


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a width and height in inches.

    Raises:
        UsageError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError("plots need matplotlib, which is not installed", remedy=install_command("view")) from error
    return Figure(figsize=(width, height), layout="constrained")


def new_axes(figure: Figure) -> Axes:
    """Return the only axes of a figure, without a frame above and on the right."""
    axes: Any = figure.add_subplot()
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.set_axisbelow(True)
    return axes
