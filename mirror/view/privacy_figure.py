"""The figure of the privacy of a dataset: which images are redacted, and what was removed from them (matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

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
    """What was removed from images.

    Attributes:
        counts: number of regions by origin, by kind.
        covered_share: share of all pixels that they cover.
    """

    counts: Mapping[str, Mapping[str, int]]
    covered_share: float


def privacy_figure(dataset: Dataset, removed: RemovedRegions | None = None) -> Figure | None:
    """Plot the raw and redacted images of each camera and, if it is known, what was removed by kind and origin."""
    rows = dataset.table("images", ["camera", "privacy"])
    if not rows.num_rows:
        return None
    counts = rows.group_by(["camera", "privacy"]).aggregate([([], "count_all")]).to_pylist()
    images = {(row["camera"], row["privacy"]): row["count_all"] for row in counts}
    cameras = dataset.cameras()
    height = 1.6 + 0.3 * len(cameras)
    figure = new_figure(6.0, height if removed is None else height + 1.6)
    first, *more = (
        [figure.subplots()] if removed is None else figure.subplots(2, 1, height_ratios=[max(len(cameras), 2), 3])
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
