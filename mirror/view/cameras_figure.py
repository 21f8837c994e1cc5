"""The figure of the cameras of a rig: mountings on one vehicle, and differences of calibration stages as bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.calibration.stages import StageDifference, compare_stages, pose_of_row
from mirror.dataset.dataset import Dataset
from mirror.geometry.cameras import camera_from_row
from mirror.view.plots import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_RIGS: Final = 6
_WEDGE_M: Final = 1.2
_VEHICLE_M: Final = ((-1.0, 3.8), (-0.95, 0.95))
"""Rear and front, right and left of the outline: a car, for scale; rigs do not state the size of their vehicle."""
_LINE: Final = "#4c78a8"
_PAIR_COLOURS: Final = {
    ("factory", "online"): "#f58518", ("factory", "refined"): "#54a24b", ("online", "refined"): "#b279a2",
}  # fmt: skip


def cameras_figure(dataset: Dataset) -> Figure | None:
    """Plot for each rig its cameras on the outline of a vehicle, and the differences of their calibration stages.

    The mounting is that of the earliest stage of the first drive. A bar is the median over the drives, its line ends at
    the largest.
    """
    history = compare_stages(dataset)
    rigs = {row["drive_id"]: row["rig_id"] for row in dataset.table("traversals", ["drive_id", "rig_id"]).to_pylist()}
    mountings: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in sorted(history.rows, key=lambda row: ("factory", "online", "refined").index(row["stage"])):
        mountings.setdefault(rigs.get(row["drive_id"]) or "unknown rig", {}).setdefault(row["camera"], row)
    if not mountings:
        return None
    shown = sorted(mountings)[:_MOST_RIGS]
    columns = 3 if history.between_stages else 1
    figure = new_figure(4.2 * columns if columns > 1 else 4.6, 4.0 * len(shown) + 0.5)
    grid: Any = figure.subplots(len(shown), columns, squeeze=False)
    for axes, rig in zip(grid, shown):
        _draw_vehicle(axes[0], mountings[rig])
        axes[0].set_title(rig, fontsize=9)
        if columns > 1:
            own = [one for one in history.between_stages if (rigs.get(one.drive_id) or "unknown rig") == rig]
            cameras = list(mountings[rig])
            _draw_bars(axes[1], cameras, own, [one.angle_deg for one in own], "angle between stages (degrees)")
            _draw_bars(axes[2], cameras, own, [one.distance_cm for one in own], "distance between stages (cm)")
    if columns > 1:
        from matplotlib.patches import Patch

        pairs = {(one.first, one.second) for one in history.between_stages}
        keys = [Patch(color=colour, label=" to ".join(pair)) for pair, colour in _PAIR_COLOURS.items() if pair in pairs]
        figure.legend(handles=keys, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    figure.suptitle("Cameras from above, and differences of their calibration stages (median, largest)", fontsize=10)
    return figure


def _draw_vehicle(axes: Any, mountings: Mapping[str, Mapping[str, Any]]) -> None:
    """Draw the outline of a vehicle once, and the place and field of view of each camera; forward is up."""
    from matplotlib.patches import FancyBboxPatch

    (rear, front), (right, left) = _VEHICLE_M
    outline = FancyBboxPatch(
        (right, rear), left - right, front - rear, boxstyle="round,pad=0,rounding_size=0.3", gid="vehicle",
        facecolor="#f2f2f0", edgecolor="#888888", linewidth=1.0,
    )  # fmt: skip
    axes.add_patch(outline)
    for name, row in mountings.items():
        lens, pose = camera_from_row(row), pose_of_row(row)
        middle = 0.5 * lens.height_px
        edge = lens.unproject([[0.5, middle], [lens.width_px - 0.5, middle]])
        place, axis = pose.translation[0], pose.matrix()[0, :3, 2]
        ends = place + _WEDGE_M * (pose.transform(edge.direction)[0] - place) if edge.valid.all() else place[None]
        wedge = np.vstack([place, ends, place])
        axes.plot(-wedge[:, 1], wedge[:, 0], color=_LINE, linewidth=0.9)
        axes.plot(-place[1], place[0], "o", color=_LINE, markersize=3)
        # The wedge of a narrow lens is inside that of a wide one: its label stands farther out.
        is_narrow = len(ends) == 2 and np.linalg.norm(ends[1] - ends[0]) < _WEDGE_M
        label = place + (1.35 if is_narrow else 0.7) * _WEDGE_M * axis
        axes.text(-label[1], label[0], name, ha="center", va="center", fontsize=6, zorder=5)
        # Texts do not widen the axes: without this a label lies on the title.
        axes.update_datalim([(-label[1], label[0])])
    axes.margins(0.1)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_xlabel("right of the rear axle (m)", fontsize=7)
    axes.set_ylabel("ahead (m)", fontsize=7)
    axes.tick_params(labelsize=7)


def _draw_bars(
    axes: Any, cameras: Sequence[str], differences: Sequence[StageDifference], values: Sequence[float], label: str
) -> None:
    """Draw a bar for each camera and pair of stages."""
    pairs = [pair for pair in _PAIR_COLOURS if any((one.first, one.second) == pair for one in differences)]
    height = 0.8 / max(len(pairs), 1)
    for number, pair in enumerate(pairs):
        for place, camera in enumerate(cameras):
            own = [
                value
                for one, value in zip(differences, values)
                if (one.camera, one.first, one.second) == (camera, *pair)
            ]
            if own:
                y = place + (number - 0.5 * (len(pairs) - 1)) * height
                axes.barh(y, float(np.median(own)), height=0.9 * height, color=_PAIR_COLOURS[pair])
                axes.plot([float(np.median(own)), max(own)], [y, y], color="#333333", linewidth=0.8)
    axes.set_yticks(range(len(cameras)), cameras, fontsize=7)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.set_xlabel(label, fontsize=7)
    axes.tick_params(labelsize=7)
