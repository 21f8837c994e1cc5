"""BOX003."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses


@scene_rule(
    "BOX003", Severity.WARNING, remedy="check the boxes' frame and the calibration; nothing, if another sensor saw them"
)
def box_unseen(view: SceneView) -> Iterator[Finding]:
    """No camera can see a box: no part of it is in any picture's frustum."""
    boxes = view.boxes
    placed = Motion(boxes)
    size = np.column_stack([boxes.floats(name) for name in ("length_m", "width_m", "height_m")])
    usable = placed.unit & np.isfinite(placed.position).all(axis=1) & (np.isfinite(size) & (size > 0)).all(axis=1)
    cameras = _cameras(view) if len(boxes) else {}
    unseen = np.zeros(len(boxes), np.bool_)
    for _, number, rows in boxes.slices():
        left = np.flatnonzero(usable[rows]) + rows.start
        for camera, ego_SE3_camera in cameras.get(number, ()):
            ego_SE3_box = Poses(placed.rotation[left], placed.position[left])
            left = left[~project_boxes(camera, ego_SE3_camera.inverse() @ ego_SE3_box, size[left]).visible]
            if not len(left):
                break
        unseen[left] = number in cameras
    far = np.linalg.norm(placed.position, axis=1)
    yield from boxes.findings(
        unseen, lambda row: f"centre {np.round(placed.position[row], 2).tolist()} m in the ego frame", worst=-far
    )


def _cameras(view: SceneView) -> dict[int, list[tuple[Camera, Poses]]]:
    """Cameras that have pictures, with their mountings, of every stage, by traversal."""
    images, rows = view.images, view.all_calibrations
    codes, names = images.words("camera")
    there = {(number, names[code]) for _, number, own in images.slices() for code in np.unique(codes[own]).tolist()}
    mounted = Motion(rows)
    found: dict[int, list[tuple[Camera, Poses]]] = {}
    for row, camera in view.cameras.items():
        number = int(rows.traversal[row])
        finite = mounted.unit[row] and np.isfinite(mounted.position[row]).all()
        if finite and (number, rows.word("camera", row)) in there:
            pose = Poses(mounted.rotation[row : row + 1], mounted.position[row : row + 1])
            found.setdefault(number, []).append((camera, pose))
    return found
