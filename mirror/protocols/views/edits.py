"""Which vehicles of a frame are edited, where they are to be, and whether a picture shows enough of them."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.dataset.frames import Frame
from mirror.dataset.traversal import FrameBoxes
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.protocols.document import Group, Protocol, Vehicles
from mirror.protocols.views.view import Edit, to_pose_numbers


class EditPlanner:
    """Finds the edits of views; what groups share is found once.

    A view is asked for if it shows enough of a chosen vehicle after any of the protocol's shifts, so that all groups
    ask for the same views.

    Args:
        protocol: says which vehicles.
    """

    def __init__(self, protocol: Protocol) -> None:
        self._vehicles = protocol.vehicles
        shifts = {group.vehicle_shift_m for group in protocol.groups if group.vehicle_shift_m is not None}
        self._shifts = sorted(shifts)
        self._asked: dict[tuple[str, int, str], bool] = {}

    def edits(
        self, group: Group, frame: Frame, name: str, camera: Camera, world_SE3_camera: Poses
    ) -> tuple[Edit, ...] | None:
        """The edits of one view; None: it is not asked for, since it shows too little of any edited vehicle.

        Args:
            group: says what is done with the vehicles.
            frame: the instant.
            name: of the camera.
            camera: the final camera.
            world_SE3_camera: its pose.
        """
        vehicles = self._vehicles
        if vehicles is None or (group.vehicle_shift_m is None and not group.without_vehicles):
            return ()
        boxes = frame.boxes("world")
        rows = _chosen(boxes, vehicles, frame)
        recorded, sizes = boxes.pose[rows], boxes.size_m[rows]
        key = (frame.traversal_id, frame.frame_index, name)
        if key not in self._asked:
            self._asked[key] = len(rows) > 0 and any(
                _shows_one(camera, world_SE3_camera, shift_to_left(recorded, shift), sizes, vehicles)
                for shift in self._shifts
            )
        if not self._asked[key]:
            return None
        targets = None if group.vehicle_shift_m is None else shift_to_left(recorded, group.vehicle_shift_m)
        return tuple(
            Edit(
                track_id=boxes.track_id[row],
                category=boxes.category[row],
                size_m=tuple(sizes[place].tolist()),
                world_SE3_box=to_pose_numbers(recorded[place : place + 1]),
                world_SE3_target=None if targets is None else to_pose_numbers(targets[place : place + 1]),
            )
            for place, row in enumerate(rows.tolist())
        )


def shift_to_left(world_SE3_box: Poses, shift_m: float) -> Poses:
    """Boxes moved along their own y axis, which is to their left."""
    count = len(world_SE3_box)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return world_SE3_box @ Poses(still, np.tile([0.0, shift_m, 0.0], (count, 1)))


def _chosen(boxes: FrameBoxes, vehicles: Vehicles, frame: Frame) -> Int64:
    if not len(boxes):
        return np.empty(0, np.int64)
    distance = np.linalg.norm(boxes.pose.translation - frame.world_SE3_ego.translation, axis=1)
    fits = np.isin(boxes.category, vehicles.categories) & (distance <= vehicles.max_distance_m)
    rows = np.flatnonzero(fits)
    if vehicles.choose == "nearest" and len(rows):
        rows = rows[[np.argmin(distance[rows])]]
    return rows


def _shows_one(
    camera: Camera, world_SE3_camera: Poses, world_SE3_box: Poses, sizes_m: Float64, vehicles: Vehicles
) -> bool:
    """Whether a box has enough pixels in the raster, and enough of itself in it."""
    projected = project_boxes(camera, world_SE3_camera.inverse() @ world_SE3_box, sizes_m)
    bounds = projected.bounds_px
    areas = np.where(projected.visible, np.prod(bounds[:, 2:] - bounds[:, :2], axis=1), 0.0)
    for row in np.flatnonzero(areas >= vehicles.min_area_px).tolist():
        hull = projected.hull(row)
        whole = float(np.prod(hull.max(axis=0) - hull.min(axis=0))) if len(hull) else np.inf
        if areas[row] >= vehicles.visible_share * whole:
            return True
    return False
