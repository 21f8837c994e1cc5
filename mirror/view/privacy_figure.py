"""The figure of the privacy of a dataset: which images are redacted, and what was removed from them (matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.view.plots import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STATE_COLOURS: Final = {"raw": "#c8553d", "redacted": "#54a24b"}
_ORIGIN_COLOURS: Final = {
    "detector": "#4c78a8", "track": "#f58518", "camera": "#b279a2", "vehicle": "#9d755d", "repeat": "#bab0ac",
    "reviewer": "#e45756",
}  # fmt: skip


@dataclass(frozen=True)
class RemovedRegions:
    """Counts of the regions that were removed from images.

    Attributes:
        counts: number of regions by origin, by kind.
        covered_share: share of all pixels that they cover.
        examples: kind, and the pixels (H, W, 3) of a region with its surroundings before and after.
    """

    counts: Mapping[str, Mapping[str, int]]
    covered_share: float
    examples: Sequence[tuple[str, UInt8, UInt8]] = field(default=(), repr=False)


def privacy_figure(dataset: Dataset, removed: RemovedRegions | None = None) -> Figure | None:
    """Plot raw and redacted images of each camera, the removed regions if they are known, and examples.

    The examples before the redaction identify people and vehicles: they are for the owner of the recordings.
    """
    rows = dataset.table("images", ["camera", "privacy"])
    if not rows.num_rows:
        return None
    counts = rows.group_by(["camera", "privacy"]).aggregate([([], "count_all")]).to_pylist()
    images = {(row["camera"], row["privacy"]): row["count_all"] for row in counts}
    cameras = dataset.cameras()
    height = 1.6 + 0.3 * len(cameras)
    examples = () if removed is None else removed.examples
    counted = height if removed is None else height + 1.6
    figure = new_figure(6.0, counted + (3.6 if examples else 0.0))
    charts: Any = figure
    if examples:
        parts: Any = figure.subfigures(2, 1, height_ratios=[counted, 3.6])
        charts, lower = parts
        _draw_examples(lower, examples)
    first, *more = (
        [charts.subplots()] if removed is None else charts.subplots(2, 1, height_ratios=[max(len(cameras), 2), 3])
    )
    states = {state: [images.get((camera, state), 0) for camera in cameras] for state in _STATE_COLOURS}
    _draw_bars(first, cameras, states, _STATE_COLOURS, "images")
    first.set_title("Images by privacy state", fontsize=10)
    if removed is not None:
        kinds = list(removed.counts)
        origins = {origin: [removed.counts[kind].get(origin, 0) for kind in kinds] for origin in _ORIGIN_COLOURS}
        _draw_bars(more[0], [f"{kind}s" for kind in kinds], origins, _ORIGIN_COLOURS, "regions")
        title = f"Removed regions by origin; they cover {removed.covered_share:.1%} of the pixels"
        more[0].set_title(title, fontsize=10)
    return figure


def _draw_examples(lower: Any, examples: Sequence[tuple[str, UInt8, UInt8]]) -> None:
    """Draw the examples in columns: before above, after below."""
    lower.suptitle("Largest regions before and after: not for publication", fontsize=10)
    grid = lower.subplots(2, len(examples), squeeze=False)
    for column, (kind, before, after) in enumerate(examples):
        for axes, pixels, name in zip(grid[:, column], (before, after), ("before", "after")):
            axes.imshow(pixels, interpolation="nearest")
            axes.set_title(f"{kind}, {name}", fontsize=8)
            axes.set_xticks([])
            axes.set_yticks([])


def _draw_bars(
    axes: Any, names: Sequence[str], values: Mapping[str, Sequence[int]], colours: Mapping[str, str], unit: str
) -> None:
    """Draw a bar for each name, with a segment for each key that has a number above 0."""
    left = np.zeros(len(names))
    for key, numbers in values.items():
        if any(numbers):
            axes.barh(names, numbers, left=left, color=colours[key], label=key, height=0.7)
            left += np.array(numbers, np.float64)
    axes.invert_yaxis()
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_xlabel(unit)
    if left.any():
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
