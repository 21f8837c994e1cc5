"""The layout of a scene in the viewer rerun: the scene in space beside a tab for each traversal with its cameras.

The active timeline is the time since the entry of each traversal, so that all traversals drive at once: on the timeline
of Unix time, months may lie between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.times import longitude_of, solar_time, utc

_SMALLEST_M: Final = 40.0
_GRID_COLUMNS: Final = 2


def make_layout(view: Dataset) -> Any:
    """Return the blueprint of a scene.

    Args:
        view: a view of one scene.

    Returns:
        A ``rerun.blueprint.Blueprint``.
    """
    from rerun import blueprint

    columns = ["traversal_id", "drive_id", "entry_ns", "light", "weather", "bbox"]
    rows = sorted(view.table("traversals", columns).to_pylist(), key=_entry)
    grids, hidden = [], []
    for row in rows:
        name = row["traversal_id"]
        cameras = view.where(traversal=name).cameras()
        views = [blueprint.Spatial2DView(origin=f"world/{name}/{camera}", name=camera) for camera in cameras]
        hidden += [f"- $origin/{name}/{camera}/masks/**" for camera in cameras]
        if views:
            local = solar_time(row["entry_ns"], longitude_of(row))
            time = f"{local} solar time" if local else f"{utc(row['entry_ns'])[11:]} UTC"
            title = f"{row['light']}, {row['weather']}: {row['drive_id']} {time}"
            grids.append(blueprint.Grid(*views, name=title, grid_columns=min(len(views), _GRID_COLUMNS)))
    scene = blueprint.Spatial3DView(
        origin="world", name="scene", contents=["$origin/**", *hidden], eye_controls=_eye_controls(view)
    )
    log = blueprint.TextLogView(origin="conditions", name="conditions")
    space = blueprint.Vertical(scene, log, row_shares=[4, 1])
    parts = [space, blueprint.Tabs(*grids, active_tab=0)] if grids else [space]
    panels = (
        blueprint.BlueprintPanel(state="collapsed"),
        blueprint.SelectionPanel(state="collapsed"),
        blueprint.TimePanel(state="collapsed", timeline="elapsed"),
    )
    return blueprint.Blueprint(blueprint.Horizontal(*parts), *panels)


def _eye_controls(view: Dataset) -> Any:
    """An eye above the driven lines that looks at their middle."""
    from rerun import blueprint

    poses = view.table("ego_poses", ["tx_m", "ty_m", "tz_m"])
    place: Float64 = np.stack([column.to_numpy() for column in poses.columns], axis=1)
    if not len(place):
        return None
    low, high = place.min(axis=0), place.max(axis=0)
    size = max(float(np.linalg.norm((high - low)[:2])), _SMALLEST_M)
    middle = (low + high) / 2
    position = middle + size * np.array([-0.5, -0.65, 0.5])
    return blueprint.EyeControls3D(position=position, look_target=middle, eye_up=(0.0, 0.0, 1.0))


def _entry(row: Mapping[str, Any]) -> int:
    return int(row["entry_ns"])
