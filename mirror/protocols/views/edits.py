"""Vehicle edits of views: which vehicles are edited, their target poses, and whether a view shows enough of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.dataset.frames import Frame
from mirror.dataset.traversal import FrameBoxes
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.protocols.document import Group, Protocol, Vehicles
from mirror.protocols.views.view import Edit


class EditPlanner:
    """A planner of the edits of views.

    A view is requested if it shows enough of a selected vehicle after any of the protocol's shifts. Therefore all
    groups request the same views, and the decision is computed once for all groups.

    Args:
        protocol: protocol that selects vehicles and shifts.
    """

    def __init__(self, protocol: Protocol) -> None:
        self._vehicles = protocol.vehicles
        shifts = {group.vehicle_shift_m for group in protocol.groups if group.vehicle_shift_m is not None}
        self._shifts = sorted(shifts)
        self._is_requested: dict[tuple[str, int, str], bool] = {}
        # All cameras of a frame follow each other: its boxes are read once, and its edits are computed once.
        self._selected: tuple[tuple[str, int], _Vehicles] | None = None
        self._edits: tuple[tuple[str, int, str], tuple[Edit, ...]] | None = None

    def plan_edits(
        self, group: Group, frame: Frame, name: str, camera: Camera, world_SE3_camera: Poses
    ) -> tuple[Edit, ...] | None:
        """Plan the edits of one view; None if the view is not requested, as it shows too little of every vehicle.

        Args:
            group: group that moves or removes the vehicles.
            frame: recorded frame.
            name: name of the camera.
            camera: final camera.
            world_SE3_camera: pose of the camera.
        """
        vehicles = self._vehicles
        if vehicles is None or (group.vehicle_shift_m is None and not group.without_vehicles):
            return ()
        key = (frame.traversal_id, frame.frame_index, name)
        if key not in self._is_requested:
            selected = self._select(frame, vehicles)
            self._is_requested[key] = len(selected.recorded) > 0 and any(
                _shows_vehicle(
                    camera, world_SE3_camera, shift_to_left(selected.recorded, shift), selected.size_m, vehicles
                )
                for shift in self._shifts
            )
        return self._edits_of(group, frame, vehicles) if self._is_requested[key] else None

    def _select(self, frame: Frame, vehicles: Vehicles) -> _Vehicles:
        key = (frame.traversal_id, frame.frame_index)
        if self._selected is None or self._selected[0] != key:
            boxes = frame.boxes("world")
            rows = _select_vehicles(boxes, vehicles, frame)
            tracks, categories = (tuple(names[row] for row in rows) for names in (boxes.track_id, boxes.category))
            self._selected = key, _Vehicles(boxes.pose[rows], boxes.size_m[rows], tracks, categories)
        return self._selected[1]

    def _edits_of(self, group: Group, frame: Frame, vehicles: Vehicles) -> tuple[Edit, ...]:
        key = (frame.traversal_id, frame.frame_index, group.name)
        if self._edits is None or self._edits[0] != key:
            selected = self._select(frame, vehicles)
            shift = group.vehicle_shift_m
            targets = None if shift is None else shift_to_left(selected.recorded, shift)
            self._edits = (
                key,
                tuple(
                    Edit(
                        track_id=track,
                        category=category,
                        size_m=tuple(selected.size_m[place].tolist()),
                        world_SE3_box=selected.recorded[place : place + 1],
                        world_SE3_target=None if targets is None else targets[place : place + 1],
                    )
                    for place, (track, category) in enumerate(zip(selected.track_ids, selected.categories))
                ),
            )
        return self._edits[1]


@dataclass(frozen=True, eq=False)
class _Vehicles:
    """The selected vehicles of a frame.

    Attributes:
        recorded: world_SE3_box of each (N,).
        size_m: length, width and height (N, 3).
        track_ids: their tracks.
        categories: their categories.
    """

    recorded: Poses
    size_m: Float64
    track_ids: tuple[str, ...]
    categories: tuple[str, ...]


def shift_to_left(world_SE3_box: Poses, shift_m: float) -> Poses:
    """Move boxes along their own y axis, in metres; positive is to the left."""
    count = len(world_SE3_box)
    no_rotation = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return world_SE3_box @ Poses(no_rotation, np.tile([0.0, shift_m, 0.0], (count, 1)))


def _select_vehicles(boxes: FrameBoxes, vehicles: Vehicles, frame: Frame) -> Int64:
    if not len(boxes):
        return np.empty(0, np.int64)
    distance = np.linalg.norm(boxes.pose.translation - frame.world_SE3_ego.translation, axis=1)
    is_selected = np.isin(boxes.category, vehicles.categories) & (distance <= vehicles.max_distance_m)
    rows = np.flatnonzero(is_selected)
    if vehicles.choose == "nearest" and len(rows):
        rows = rows[[np.argmin(distance[rows])]]
    return rows


def _shows_vehicle(
    camera: Camera, world_SE3_camera: Poses, world_SE3_box: Poses, sizes_m: Float64, vehicles: Vehicles
) -> bool:
    """Return whether the bounds of any box cover enough pixels of the raster, and lie in it by a large enough share."""
    projected = project_boxes(camera, world_SE3_camera.inverse() @ world_SE3_box, sizes_m)
    bounds = projected.bounds_px
    areas = np.where(projected.visible, np.prod(bounds[:, 2:] - bounds[:, :2], axis=1), 0.0)
    for row in np.flatnonzero(areas >= vehicles.min_area_px).tolist():
        hull = projected.hull(row)
        unclipped_area = float(np.prod(hull.max(axis=0) - hull.min(axis=0))) if len(hull) else np.inf
        if areas[row] >= vehicles.visible_share * unclipped_area:
            return True
    return False
