"""One picture that a submission is asked for: its name, raster, lens, pose and what is edited in it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.schema.documents import Document

PoseNumbers = Annotated[tuple[float, ...], Field(min_length=7, max_length=7)]
"""``qw qx qy qz tx_m ty_m tz_m``."""


class Edit(Document):
    """One vehicle that is moved, or taken out.

    Attributes:
        track_id: the vehicle, within its traversal.
        category: its class.
        size_m: length, width, height.
        world_SE3_box: its recorded pose.
        world_SE3_target: where it is to be; None: nowhere.
    """

    track_id: str
    category: str
    size_m: tuple[float, float, float]
    world_SE3_box: PoseNumbers
    world_SE3_target: PoseNumbers | None


class RenderView(Document):
    """One picture.

    Attributes:
        path: of the render, relative to the submission.
        group: the protocol's group.
        scene_id: the scene.
        traversal_id: the traversal.
        frame_index: the frame within it.
        camera: the camera's name.
        timestamp_ns: mid-exposure.
        light: condition of the traversal.
        weather: condition of the traversal.
        model: of the final lens: ``pinhole``, or the camera's own.
        width_px: of the render.
        height_px: of the render.
        fx_px: of the final lens.
        fy_px: of the final lens.
        cx_px: of the final lens; the centre of the first pixel is at 0.5.
        cy_px: of the final lens; the centre of the first pixel is at 0.5.
        distortion: of the final lens.
        world_SE3_camera: the pose to render from.
        edits: what is moved or taken out.
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
        """The final camera."""
        return Camera(
            self.model,
            self.width_px,
            self.height_px,
            self.fx_px,
            self.fy_px,
            self.cx_px,
            self.cy_px,
            self.distortion,
        )

    @property
    def pose(self) -> Poses:
        """``world_SE3_camera``, one pose."""
        return to_pose(self.world_SE3_camera)


def to_pose(numbers: tuple[float, ...]) -> Poses:
    """One pose of its seven numbers."""
    return Poses(np.array([numbers[:4]]), np.array([numbers[4:]]))


def to_pose_numbers(pose: Poses) -> tuple[float, ...]:
    """The seven numbers of one pose."""
    return (*pose.rotation[0].tolist(), *pose.translation[0].tolist())
