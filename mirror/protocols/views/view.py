"""A view: one image that a submission must render, with its path, raster, lens, pose and vehicle edits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, PlainSerializer, PlainValidator, WithJsonSchema

from mirror.errors import UsageError
from mirror.geometry.cameras import Camera, camera_from_attributes
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.schema.documents import Document


def to_pose(numbers: Poses | tuple[float, ...]) -> Poses:
    """Make one pose from its seven numbers ``qw qx qy qz tx_m ty_m tz_m``; return a pose unchanged."""
    if isinstance(numbers, Poses):
        return numbers
    return Poses(np.array([numbers[:4]]), np.array([numbers[4:]]))


def _read_pose(value: object) -> Poses:
    """Return one pose of a pose or of seven numbers; a validator of documents.

    Raises:
        ValueError: it is neither.
    """
    if isinstance(value, Poses):
        if len(value) != 1:
            raise ValueError(f"{len(value)} poses, expected one")
        return value
    is_seven = isinstance(value, (list, tuple)) and len(value) == 7
    if not is_seven or not all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in value):  # type: ignore[attr-defined]
        raise ValueError("expected one pose: seven numbers, qw qx qy qz tx_m ty_m tz_m")
    try:
        return to_pose(tuple(map(float, value)))  # type: ignore[call-overload]
    except UsageError as error:
        raise ValueError(str(error)) from error


PoseField = Annotated[
    Poses,
    PlainValidator(_read_pose),
    PlainSerializer(to_pose_numbers, return_type=tuple[float, ...]),
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 7, "maxItems": 7}),
]
"""One pose; in files its seven numbers ``qw qx qy qz tx_m ty_m tz_m``."""


class _Posed(Document):
    """A document with poses: equal if all values are, poses bit for bit."""

    model_config = ConfigDict(arbitrary_types_allowed=True)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash(self._values())

    def _values(self) -> tuple[object, ...]:
        return tuple(to_pose_numbers(one) if isinstance(one, Poses) else one for one in self.__dict__.values())

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values; a pose may be given as its seven numbers, as earlier versions had it."""
        changed = {
            name: to_pose(value) if name.startswith("world_SE3_") and value is not None else value
            for name, value in (update or {}).items()
        }
        return super().model_copy(update=changed, deep=deep)


class Edit(_Posed):
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
    world_SE3_box: PoseField
    world_SE3_target: PoseField | None


RollingDirection = Literal["top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"]


class ViewShutter(_Posed):
    """The rolling shutter of a view's raster.

    Attributes:
        direction: direction in which rows or columns are exposed.
        first_ns: time of the line that is exposed first, from mid-exposure.
        last_ns: time of the line that is exposed last.
        world_SE3_first: pose of the camera at the first time.
        world_SE3_last: pose of the camera at the last time.
    """

    direction: RollingDirection
    first_ns: float
    last_ns: float
    world_SE3_first: PoseField
    world_SE3_last: PoseField


class RenderView(_Posed):
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
        world_SE3_camera: pose of the camera; `pose` is the same.
        edits: vehicles that are moved or removed.
        shutter: rolling shutter of the view; None: all of it is seen at mid-exposure.
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
    world_SE3_camera: PoseField
    edits: tuple[Edit, ...] = ()
    shutter: ViewShutter | None = Field(default=None, exclude_if=lambda shutter: shutter is None)

    @property
    def lens(self) -> Camera:
        """The camera model of the render."""
        return camera_from_attributes(self)

    @property
    def pose(self) -> Poses:
        """``world_SE3_camera``."""
        return self.world_SE3_camera
