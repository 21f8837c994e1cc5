"""Clips of the synthetic street: images with traffic, the same views of the empty street, and exact boxes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np

from hybridworldsim.generation.clips.clip import ABSENT, CATEGORIES, Clip, ClipBoxes
from hybridworldsim.generation.clips.map_lines import MapLine, crop_lines, move_lines
from hybridworldsim.generation.clips.road_map import lines_of_map
from mirror.arrays import AnyArray, Float64, UInt8
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drive
from mirror.synth.fleet.presets import PRESETS
from mirror.synth.light.condition import Effects
from mirror.synth.maps import street_map
from mirror.synth.model import Model
from mirror.synth.render.lens import make_lens
from mirror.synth.render.scene import RenderedImage, Scene
from mirror.synth.writing.boxes import world_SE3_boxes

VIEWS: Final = ("front_left", "front", "front_right")
_YAW_DEG: Final = (45.0, 0.0, -45.0)
_WIDTH_DEG: Final = 65.0
"""Neighbouring views overlap by 20 degrees."""
_MOUNT_M: Final = (1.5, 0.0, 1.6)
RATE_HZ: Final = 5.0
_FARTHEST_M: Final = 60.0
_VARYING: Final = ("exposure", "white_balance", "noise", "vignetting", "motion_blur", "bloom", "lens_drops")
"""Effects that would differ between an image and its background."""


@dataclass(frozen=True)
class StreetRig:
    """Three pinhole cameras on the roof, looking ahead and to both sides.

    Attributes:
        height_px: height of the images.
        width_px: width of the images.
    """

    height_px: int = 64
    width_px: int = 96

    @property
    def camera(self) -> Camera:
        """The camera of all views."""
        focal = 0.5 * self.width_px / float(np.tan(np.radians(0.5 * _WIDTH_DEG)))
        return Camera(
            "pinhole", self.width_px, self.height_px, fx_px=focal, fy_px=focal,
            cx_px=0.5 * self.width_px, cy_px=0.5 * self.height_px,
        )  # fmt: skip

    @property
    def intrinsics(self) -> Float64:
        """(V, 3, 3), pixels."""
        camera = self.camera
        matrix = [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
        return np.tile(np.array(matrix), (len(VIEWS), 1, 1))

    @property
    def ego_SE3_camera(self) -> Float64:  # noqa: N802
        """(V, 4, 4)."""
        poses = np.tile(np.eye(4), (len(VIEWS), 1, 1))
        for pose, yaw in zip(poses, np.radians(_YAW_DEG)):
            cos, sin = np.cos(yaw), np.sin(yaw)
            pose[:3, :3] = np.array([[sin, -cos, 0.0], [0.0, 0.0, -1.0], [cos, sin, 0.0]]).T
            pose[:3, 3] = _MOUNT_M
        return poses


def busy_drive(preset: str, route: str, seed: int, bustle: float, drive_id: str) -> SynthDrive:
    """Return a drive in dense traffic, without the effects of the camera.

    Args:
        preset: a preset of the synthetic street.
        route: id of one of its drives, for the world, the route, the vehicle and the light.
        seed: seed of the traffic.
        bustle: density of the traffic, as a share of that of a busy day.
        drive_id: id of the result.
    """
    drive = make_drive(preset, seed, route)
    site = replace(drive.site, bustle=bustle)
    sites = tuple(site if place == drive.scene else other for place, other in enumerate(drive.preset.sites))
    # Worlds are cached by the preset's name and are those of seed 0; only the traffic follows the seed.
    return replace(
        drive,
        drive_id=drive_id,
        preset=replace(PRESETS[preset], sites=sites),
        condition=replace(drive.condition, effects=Effects.without(_VARYING)),
        world_seed=make_drive(preset, 0, route).world_seed,
    )


_Box: TypeAlias = tuple[int, int, Float64, Float64]
"""Track, class, pose in the ego frame (4, 4), and size (3,)."""


class StreetRecorder:
    """Renders a drive with and without its road users.

    Args:
        drive: the drive.
        rig: the cameras.
    """

    def __init__(self, drive: SynthDrive, rig: StreetRig) -> None:
        self.drive, self.rig = drive, rig
        world, condition, clock_s = drive.world, drive.condition, drive.truth.clock_s
        self.street = Scene(world, condition, drive.road_users, Model.empty(), clock_s=clock_s)
        self.empty = Scene(world, condition, (), Model.empty(), clock_s=clock_s)
        self._lens = make_lens(rig.camera)
        self._ego_SE3_camera = Poses.from_matrix(rig.ego_SE3_camera)

    @property
    def times_s(self) -> Float64:
        """Times of the frames."""
        return np.arange(0.0, self.drive.truth.duration_s, 1.0 / RATE_HZ)

    def ego(self, times_s: Float64) -> Poses:
        """Return ``world_SE3_ego`` at (N,) times."""
        return self.drive.truth.poses(times_s)

    def tracks(self, times_s: Float64) -> AnyArray:
        """Return the number of the road user in each pixel (F, V, H, W) at (F,) times, `ABSENT` elsewhere."""
        egos = self.ego(times_s)
        return np.stack(
            [
                np.stack(
                    [rendered.view.object for rendered in self.with_traffic(float(time_s), egos[place : place + 1])]
                )
                for place, time_s in enumerate(times_s)
            ]
        ).astype(np.int16)

    def record(self, clip_id: str, times_s: Float64, *, with_map: bool = False) -> Clip:
        """Render the frames at (F,) times.

        Args:
            clip_id: id of the clip.
            times_s: (F,) times.
            with_map: whether the clip has the lines of the exact map that its frames show.
        """
        egos = self.ego(times_s)
        frames = [self._frame(float(time_s), egos[place : place + 1]) for place, time_s in enumerate(times_s)]
        rows = [(place, *box) for place, (_, _, _, boxes) in enumerate(frames) for box in boxes]
        frame, track, category, pose, size = zip(*rows) if rows else ((), (), (), (), ())
        to_start = egos[np.zeros(len(egos), np.int64)].inverse() @ egos
        return Clip(
            clip_id,
            self.drive.drive_id,
            RATE_HZ,
            VIEWS,
            np.stack([images for images, _, _, _ in frames]),
            np.stack([background for _, background, _, _ in frames]),
            np.ones((len(times_s), len(VIEWS)), bool),
            self.rig.intrinsics,
            self.rig.ego_SE3_camera,
            to_start.matrix(),
            ClipBoxes(
                np.array(frame, np.int64),
                np.array(track, np.int64),
                np.array(category, np.int64),
                np.array(pose, np.float64).reshape(-1, 4, 4),
                np.array(size, np.float64).reshape(-1, 3),
            ),
            np.stack([tracks for _, _, tracks, _ in frames]),
            self.lines(egos) if with_map else None,
        )

    def lines(self, egos: Poses) -> tuple[MapLine, ...]:
        """Return the lines of the exact map near the vehicle's poses, in the frame of the first one."""
        lines = lines_of_map(street_map(self.drive.world.plan), egos.translation)
        return move_lines(crop_lines(lines, egos.translation), egos.inverse().matrix()[0])

    def _frame(self, time_s: float, ego: Poses) -> tuple[UInt8, UInt8, AnyArray, list[_Box]]:
        """Images, backgrounds and tracks of the views at one time, and the boxes of its visible road users."""
        without = self.empty.around(time_s, ego.translation[0])
        images, backgrounds, tracks = [], [], []
        for view, rendered in enumerate(self.with_traffic(time_s, ego)):
            pose = ego @ self._ego_SE3_camera[view : view + 1]
            images.append(rendered.bgr[..., ::-1])
            tracks.append(rendered.view.object.astype(np.int16))
            backgrounds.append(self.empty.render(without, self._lens, pose).bgr[..., ::-1])
        shown = np.unique(np.stack(tracks))
        return (
            np.stack(images), np.stack(backgrounds), np.stack(tracks),
            self._boxes(time_s, ego, shown[shown != ABSENT].tolist()),
        )  # fmt: skip

    def with_traffic(self, time_s: float, ego: Poses) -> Iterator[RenderedImage]:
        """Yield the street with its road users at a time and a pose of the vehicle, view by view."""
        instant = self.street.around(time_s, ego.translation[0])
        for view in range(len(VIEWS)):
            yield self.street.render(instant, self._lens, ego @ self._ego_SE3_camera[view : view + 1])

    def _boxes(self, time_s: float, ego: Poses, numbers: list[int]) -> list[_Box]:
        """Track, class, pose and size of the visible road users that are near."""
        users = [self.drive.road_users[number] for number in numbers]
        boxes = ego[np.zeros(len(users), np.int64)].inverse() @ world_SE3_boxes(
            users, [user.motion.at(time_s) for user in users]
        )
        near = np.linalg.norm(boxes.translation, axis=1) < _FARTHEST_M
        return [
            (number, CATEGORIES.index(user.body.category), matrix, np.array(user.body.size_m))
            for number, user, matrix, is_near in zip(numbers, users, boxes.matrix(), near)
            if is_near
        ]
