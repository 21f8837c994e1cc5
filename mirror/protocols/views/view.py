"""A view: one image that a submission must render, with its path, raster, lens, pose and vehicle edits."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from mirror.geometry.cameras import Camera, camera_from_attributes
from mirror.geometry.poses import Poses
from mirror.schema.documents import Document

PoseNumbers = Annotated[tuple[float, ...], Field(min_length=7, max_length=7)]
"""``qw qx qy qz tx_m ty_m tz_m``."""


class Edit(Document):
    """One vehicle that is moved or removed.

    Attributes:
        track_id: track of the vehicle within its traversal.
        category: box category of the vehicle.
        size_m: length, width, height.
        world_SE3_box: recorded pose.
        world_SE3_target: requested pose; None: the vehicle is removed.
    """

    track_id: str
    category: str
    size_m: tuple[float, float, float]
    world_SE3_box: PoseNumbers
    world_SE3_target: PoseNumbers | None


class RenderView(Document):
    """One image that a submission must render.

    Attributes:
        path: path of the render, relative to the submission.
        group: group of the protocol.
        scene_id: scene.
        traversal_id: traversal.
        frame_index: index of the frame within the traversal.
        camera: name of the camera.
        timestamp_ns: time of mid-exposure.
        light: light condition of the traversal.
        weather: weather condition of the traversal.
        model: model of the final lens: ``pinhole``, or that of the recorded camera.
        width_px: width of the render.
        height_px: height of the render.
        fx_px: focal length of the final lens.
        fy_px: focal length of the final lens.
        cx_px: principal point of the final lens; the centre of the first pixel is at 0.5.
        cy_px: principal point of the final lens; the centre of the first pixel is at 0.5.
        distortion: distortion coefficients of the final lens.
        world_SE3_camera: pose of the camera as numbers; `pose` is the same as `Poses`, the type of all other poses.
        edits: vehicles that are moved or removed.
    """

    path: str
    group: str
    scene_id: str
    traversal_id: str
    frame_index: int
    camera: str
    timestamp_ns: int
    light: str
    weather: str
    model: str
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...]
    world_SE3_camera: PoseNumbers
    edits: tuple[Edit, ...] = ()

    @property
    def lens(self) -> Camera:
        """The camera model of the render."""
        return camera_from_attributes(self)

    @property
    def pose(self) -> Poses:
        """``world_SE3_camera`` as one pose."""
        return to_pose(self.world_SE3_camera)


def to_pose(numbers: tuple[float, ...]) -> Poses:
    """Make one pose from its seven numbers ``qw qx qy qz tx_m ty_m tz_m``."""
    return Poses(np.array([numbers[:4]]), np.array([numbers[4:]]))
