"""AlpaSim's ``SensorsimService``: images of a street from anywhere, for another simulator."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hybridworldsim.simulator.policies.protocol import Readout
from hybridworldsim.simulator.remote.images import Format, encode
from hybridworldsim.simulator.remote.lenses import direction_of, from_spec, to_spec
from hybridworldsim.simulator.remote.messages import wire
from hybridworldsim.simulator.remote.poses import flat, from_pose, to_pose
from hybridworldsim.simulator.remote.scenes import ServedScene
from hybridworldsim.simulator.renderers.protocol import CameraView
from hybridworldsim.simulator.renderers.rolling import make_shutter
from mirror.arrays import Float64
from mirror.errors import MirrorError, UsageError
from mirror.geometry import Poses, interpolate
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import RollingShutter, ShutterDirection
from mirror.protocols.views.view import ViewShutter

WIRE_NAMES: Final = {
    "front_wide": "camera_front_wide_120fov",
    "front_narrow": "camera_front_tele_30fov",
    "front_left": "camera_cross_left_120fov",
    "front_right": "camera_cross_right_120fov",
    "rear_left": "camera_rear_left_70fov",
    "rear_right": "camera_rear_right_70fov",
    "rear": "camera_rear_tele_30fov",
}
"""AlpaSim's names of the cameras of a MIRROR rig; cameras of other rigs keep theirs."""
_QUALITY: Final = 95


class UnknownSceneError(UsageError):
    """A request names a scene that is not served."""


class TooManyError(MirrorError):
    """More images were asked for than the service renders."""


@dataclass(frozen=True)
class Limits:
    """Limits of what the sensor service renders.

    Attributes:
        side_px: width or height of one image.
        pixels: of one image.
        request_pixels: of all images of one request, which are held in memory together.
        images: in one request.
        agents: of one image.
        images_per_s: on average over a second; twice as many at once.
        pixels_per_s: on average over a second; twice as many at once.
    """

    side_px: int = 8192
    pixels: int = 1 << 24
    request_pixels: int = 1 << 25
    images: int = 16
    agents: int = 1000
    images_per_s: float = 200.0
    pixels_per_s: float = float(1 << 26)


class SensorService:
    """The sensor service's answers to its calls; each method takes a request and returns an answer.

    Args:
        scenes: the scenes by id.
        limits: what is rendered at most.
    """

    def __init__(self, scenes: Mapping[str, ServedScene], limits: Limits | None = None) -> None:
        self._scenes, self._limits = dict(scenes), limits or Limits()
        self._messages = wire()
        self._rendering = threading.Lock()
        self._budgets = _Budget(self._limits.images_per_s, "images"), _Budget(self._limits.pixels_per_s, "pixels")
        formats = self._messages.image_formats
        self._formats: dict[int, Format] = {formats["PNG"]: "png", formats["JPEG"]: "jpeg"}

    def calls(self) -> dict[str, tuple[str, Callable[[Any], Any]]]:
        """Return the methods that answer calls, and the messages of their requests, by name."""
        return {
            "get_version": ("Empty", lambda _: self._messages.version()),
            "get_available_scenes": ("Empty", self.list_scenes),
            "get_available_cameras": ("AvailableCamerasRequest", self.list_cameras),
            "get_available_ego_masks": ("Empty", lambda _: self._messages.AvailableEgoMasksReturn()),
            "render_rgb": ("RGBRenderRequest", self.render),
            "batch_render_rgb": ("BatchRGBRenderRequest", self.render_batch),
        }

    def list_scenes(self, request: Any) -> Any:
        """Return the ids of the scenes."""
        return self._messages.AvailableScenesReturn(scene_ids=sorted(self._scenes))

    def list_cameras(self, request: Any) -> Any:
        """Return the calibrated cameras of a scene's rig.

        Raises:
            UnknownSceneError: there is no such scene.
        """
        answer = self._messages.AvailableCamerasReturn()
        for name, member in self._scene(request.scene_id).street.rig.items():
            wired = WIRE_NAMES.get(name, name)
            answer.available_cameras.add(
                intrinsics=to_spec(member.camera, wired, direction=_direction(member.shutter)),
                rig_to_camera=to_pose(member.ego_SE3_camera),
                logical_id=wired,
            )
        return answer

    def render(self, request: Any) -> Any:
        """Render one image.

        Raises:
            MirrorError: the request is not valid, or more than is rendered.
        """
        self._take([request])
        (data,) = self._render_group([self._job("image", request)])
        return self._messages.RGBRenderReturn(image_bytes=data)

    def render_batch(self, request: Any) -> Any:
        """Render several images; an image that fails does not stop the others.

        Raises:
            MirrorError: there are more images than are rendered.
        """
        if len(request.items) > self._limits.images:
            raise UsageError(f"{len(request.items)} images", expected=f"at most {self._limits.images} in a request")
        self._take([item.request for item in request.items])
        answer = self._messages.BatchRGBRenderReturn()
        groups: dict[tuple[object, ...], list[tuple[Any, _Job]]] = {}
        for number, item in enumerate(request.items):
            row = answer.items.add(camera_name=item.camera_name)
            try:
                job = self._job(f"{number}", item.request)
            except MirrorError as error:
                row.error_message = str(error)
                continue
            groups.setdefault(job.instant, []).append((row, job))
        for members in groups.values():
            try:
                images = self._render_group([job for _, job in members])
            except MirrorError as error:
                for row, _ in members:
                    row.error_message = str(error)
                continue
            for (row, _), data in zip(members, images, strict=True):
                row.success, row.result.image_bytes = True, data
        return answer

    def _take(self, requests: Sequence[Any]) -> None:
        """Take the images and the pixels of a request from what is rendered in a second; refused images take none.

        Raises:
            UsageError: all images together are larger than is rendered.
            TooManyError: too many were asked for in the last second.
        """
        most = self._limits.request_pixels
        pixels = sum(width * height for width, height in map(_size, requests) if self._is_rendered(width, height))
        if pixels > most:
            raise UsageError(f"images of {pixels} pixels in one request", expected=f"at most {most}")
        for budget, count in zip(self._budgets, (len(requests), pixels), strict=True):
            budget.take(count)

    def _is_rendered(self, width: int, height: int) -> bool:
        """Return whether images of this size are rendered."""
        limits = self._limits
        return min(width, height) >= 1 and max(width, height) <= limits.side_px and width * height <= limits.pixels

    def _scene(self, scene_id: str) -> ServedScene:
        if scene_id not in self._scenes:
            raise UnknownSceneError(f"no scene {scene_id!r}", expected=f"one of {', '.join(sorted(self._scenes))}")
        return self._scenes[scene_id]

    def _job(self, name: str, request: Any) -> _Job:
        limits, scene = self._limits, self._scene(request.scene_id)
        if request.insert_ego_mask:
            raise UsageError("insert_ego_mask", expected="false: no masks of the ego vehicle are available")
        if request.image_format not in self._formats:
            raise UsageError(f"image format {request.image_format}", expected="PNG or JPEG")
        if request.image_quality and not 1.0 <= request.image_quality <= 100.0:
            raise UsageError(f"image_quality is {request.image_quality}", expected="1 to 100")
        width, height = _size(request)
        if not self._is_rendered(width, height):
            expected = f"1 to {limits.pixels} pixels, sides of at most {limits.side_px}"
            raise UsageError(f"an image of {width} x {height} px", expected=expected)
        if len(request.dynamic_objects) > limits.agents:
            raise UsageError(f"{len(request.dynamic_objects)} dynamic objects", expected=f"at most {limits.agents}")
        if request.frame_end_us < request.frame_start_us:
            raise UsageError("the frame ends before it starts", place="frame_end_us")
        camera = from_spec(request.camera_intrinsics).resized(width, height)
        pose = _middle(request.sensor_pose, "sensor_pose")
        exposure_us = request.frame_end_us - request.frame_start_us
        exposure_s = 1e-6 * exposure_us
        shutter = _shutter(request, camera, 1000 * exposure_us)
        places = {
            user.track_id: _flat_middle(user.pose_pair, f"dynamic object {user.track_id!r}", exposure_s)
            for user in request.dynamic_objects
        }
        stamp_ns = 500 * (request.frame_start_us + request.frame_end_us)
        if stamp_ns >= 1 << 63:
            raise UsageError("a stamp beyond the year 2262", place="frame_end_us", expected="Unix time in microseconds")
        instant = (
            request.scene_id,
            stamp_ns,
            exposure_s,
            *(user.SerializeToString() for user in request.dynamic_objects),
        )
        view, image_format = CameraView(name, camera, pose, shutter), self._formats[request.image_format]
        quality = round(request.image_quality) or _QUALITY
        return _Job(instant, scene, view, places, stamp_ns, image_format, quality)

    def _render_group(self, jobs: Sequence[_Job]) -> list[bytes]:
        first = jobs[0]
        with self._rendering:
            images = first.scene.render([job.view for job in jobs], first.places, first.stamp_ns)
        return [encode(images[job.view.name], job.image_format, job.quality) for job in jobs]


@dataclass(frozen=True, eq=False)
class _Job:
    instant: tuple[object, ...]
    scene: ServedScene
    view: CameraView
    places: Mapping[str, Float64]
    stamp_ns: int
    image_format: Format
    quality: int


class _Budget:
    """Images or pixels that may be rendered: they come back at a rate."""

    def __init__(self, per_s: float, unit: str) -> None:
        self._unit = unit
        self._per_s, self._left, self._at = per_s, 2.0 * per_s, time.monotonic()
        self._lock = threading.Lock()

    def take(self, count: int) -> None:
        with self._lock:
            now = time.monotonic()
            self._left = min(self._left + (now - self._at) * self._per_s, 2.0 * self._per_s)
            self._at = now
            if count > self._left:
                remedy = "--rate" if self._unit == "images" else "ask later, or for smaller images"
                raise TooManyError(f"{count} {self._unit}", expected=f"at most {self._per_s:g} a second", remedy=remedy)
            self._left -= count


def _size(request: Any) -> tuple[int, int]:
    """Width and height of the image that a request asks for."""
    spec = request.camera_intrinsics
    return request.resolution_w or spec.resolution_w, request.resolution_h or spec.resolution_h


def _direction(shutter: RollingShutter | None) -> ShutterDirection:
    return shutter.direction if shutter is not None and shutter.is_rolling else "global"


def _shutter(request: Any, camera: Camera, exposure_ns: int) -> ViewShutter | None:
    """The shutter of an image whose first line is exposed at the start pose and whose last line is at the end pose."""
    direction = direction_of(request.camera_intrinsics)
    if direction == "global" or exposure_ns == 0:
        return None
    RollingShutter(direction, exposure_ns, camera.width_px, camera.height_px)
    ends = _ends(request.sensor_pose, "sensor_pose")
    return make_shutter(Readout(direction, -0.5 * exposure_ns, 0.5 * exposure_ns), ends)


def _ends(pair: Any, place: str) -> Poses:
    """The two poses of a pair."""
    start, end = from_pose(pair.start_pose, place), from_pose(pair.end_pose, place)
    return Poses(np.concatenate([start.rotation, end.rotation]), np.concatenate([start.translation, end.translation]))


def _middle(pair: Any, place: str) -> Poses:
    """The pose in the middle of the exposure."""
    return interpolate([0, 2], _ends(pair, place), [1])


def _flat_middle(pair: Any, place: str, exposure_s: float) -> Float64:
    """x, y, yaw and speed (4,) in the middle of the exposure; the speed is NaN if the poses do not tell it."""
    start, end = flat([pair.start_pose, pair.end_pose], [place, place])
    turn = np.remainder(end[2] - start[2] + np.pi, 2.0 * np.pi) - np.pi
    moved_m = float(np.hypot(*(end[:2] - start[:2])))
    speed_mps = moved_m / exposure_s if exposure_s > 0.0 and moved_m > 0.0 else np.nan
    return np.array([*(0.5 * (start[:2] + end[:2])), start[2] + 0.5 * turn, speed_mps])
