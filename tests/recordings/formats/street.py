"""Drives through a synthetic street with exact truth, which every writer of a format writes in its own layout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import cv2
import numpy as np

from mirror.arrays import Float64, Int64
from mirror.geometry.cameras.camera import Camera
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_exp, quaternion_from_heading_pitch_roll

if TYPE_CHECKING:
    from mirror.synth.fleet.drive import SynthDrive

SECOND_NS = 1_000_000_000
_FORWARD = (0.5, -0.5, 0.5, -0.5)


@dataclass(frozen=True)
class StreetObject:
    """A road user at the stamps of its drive's boxes.

    Attributes:
        track_id: its id.
        category: class in MIRROR's words.
        size_m: length, width, height.
        world_SE3_box: (K,) poses of the box; x forward, y left, z up.
    """

    track_id: str
    category: str
    size_m: tuple[float, float, float]
    world_SE3_box: Poses


@dataclass(frozen=True)
class StreetDrive:
    """One drive; the world is a metric frame, x east, y north, z up.

    Attributes:
        name: its id.
        vehicle: its vehicle's id.
        light: ``day`` or ``night``.
        weather: ``clear`` or ``rain``.
        pose_ns: (N,) stamps of the poses, whole microseconds.
        poses_at: true ``world_SE3_ego`` at any stamps.
        cameras: pinhole cameras by canonical name.
        ego_SE3_camera: mountings by camera name.
        image_ns: (M,) stamps of the images by camera name, whole microseconds.
        box_ns: (K,) stamps of the boxes; each is the stamp of a pose.
        objects: the road users near the vehicle.
    """

    name: str
    vehicle: str
    light: str
    weather: str
    pose_ns: Int64
    poses_at: Callable[[Int64], Poses]
    cameras: dict[str, Camera]
    ego_SE3_camera: dict[str, Poses]
    image_ns: dict[str, Int64]
    box_ns: Int64
    objects: tuple[StreetObject, ...]

    @property
    def poses(self) -> Poses:
        """True poses at `pose_ns`."""
        return self.poses_at(self.pose_ns)

    def placed(self, offset_m: tuple[float, float, float]) -> StreetDrive:
        """The same drive with the street's origin at another place of the world."""

        def moved(poses: Poses) -> Poses:
            return Poses(poses.rotation, poses.translation + offset_m)

        objects = tuple(replace(one, world_SE3_box=moved(one.world_SE3_box)) for one in self.objects)
        return replace(self, poses_at=lambda stamps: moved(self.poses_at(stamps)), objects=objects)

    def upright(self) -> StreetDrive:
        """The same drive with boxes that are turned about z alone, for formats that have no other rotation."""

        def level(poses: Poses) -> Poses:
            ahead = matrix_from_quaternion(poses.rotation)[:, :, 0]
            yaw = np.arctan2(ahead[:, 1], ahead[:, 0])
            return Poses(quaternion_exp(np.outer(yaw, (0.0, 0.0, 1.0))), poses.translation)

        return replace(
            self, objects=tuple(replace(one, world_SE3_box=level(one.world_SE3_box)) for one in self.objects)
        )

    def with_cameras(self, names: tuple[str, ...]) -> StreetDrive:
        """The same drive with some of its cameras."""
        chosen = [{name: values[name] for name in names} for values in (self.cameras, self.ego_SE3_camera)]
        return replace(
            self,
            cameras=chosen[0],
            ego_SE3_camera=chosen[1],
            image_ns={name: self.image_ns[name] for name in names},
        )

    def image(self, camera: str, index: int, suffix: str = ".jpg") -> bytes:
        """An encoded image of the camera's raster; its pixels depend on camera and index."""
        lens = self.cameras[camera]
        seed = [sorted(self.cameras).index(camera), index]
        small = np.random.default_rng(seed).integers(0, 255, (3, 4, 3), np.uint8)
        return cv2.imencode(suffix, cv2.resize(small, (lens.width_px, lens.height_px)))[1].tobytes()


@cache
def synth_drives() -> tuple[StreetDrive, ...]:
    """Two drives of `mirror.synth`'s tiny street, one by day and one by night: 14 s each, within 90 m of its origin."""
    from mirror.synth.fleet.drives import make_drives

    return tuple(_from_synth(drive) for drive in make_drives("tiny", seed=0)[1][:2])


def _from_synth(drive: SynthDrive) -> StreetDrive:
    start_ns = drive.condition.start_ns // 1_000 * 1_000 + _fastest_second(drive) * SECOND_NS
    box_ns = start_ns + np.arange(0, 14 * SECOND_NS + 1, SECOND_NS // 2)
    mountings = {name: Poses(pose.rotation, pose.translation) for name, pose in drive.vehicle.ego_SE3_camera.items()}
    near = []
    ego = drive.world_SE3_ego(box_ns)
    for user in drive.road_users:
        placed, _ = drive.placements(user, box_ns)
        distance = np.linalg.norm(placed[:, :2] - ego.translation[:, :2], axis=1)
        near.append((float(distance.min()), user.track_id, user, placed))
    objects = tuple(
        StreetObject(user.track_id, user.body.category, user.body.size_m, _box_poses(placed, user.body.size_m[2]))
        for _, _, user, placed in sorted(near, key=lambda entry: entry[:2])[:5]
    )
    return StreetDrive(
        name=drive.drive_id,
        vehicle=drive.vehicle.vehicle_id,
        light=drive.condition.light,
        weather=drive.condition.weather,
        pose_ns=start_ns + np.arange(0, 14 * SECOND_NS + 1, SECOND_NS // 20),
        poses_at=drive.world_SE3_ego,
        cameras={name: _pinhole(number) for number, name in enumerate(drive.vehicle.cameras)},
        ego_SE3_camera=mountings,
        image_ns={
            name: start_ns + 7_000_000 * number + np.arange(0, 13 * SECOND_NS, SECOND_NS // 4)
            for number, name in enumerate(drive.vehicle.cameras)
        },
        box_ns=box_ns,
        objects=objects,
    )


def _fastest_second(drive: SynthDrive) -> int:
    """The second at which the 14 s with the longest path begin."""
    seconds = np.arange(2, int(drive.truth.duration_s) - 1)
    place = drive.world_SE3_ego(drive.condition.start_ns + seconds * SECOND_NS).translation
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))])
    return int(seconds[np.argmax(path[14:] - path[:-14])])


def _box_poses(placed: Float64, height_m: float) -> Poses:
    yaw, pitch, roll = np.degrees(placed[:, 3:]).T
    body = Poses(quaternion_from_heading_pitch_roll(90.0 - yaw, pitch, roll), placed[:, :3])
    up = np.tile((0.0, 0.0, height_m / 2), (len(placed), 1))
    return body @ Poses(np.tile((1.0, 0.0, 0.0, 0.0), (len(placed), 1)), up)


def _pinhole(number: int) -> Camera:
    return Camera("pinhole", 64, 36, 40.25 + number, 40.75 + number, 31.125 + 0.25 * number, 18.375, ())


def straight_drive() -> StreetDrive:
    """A drive eastward at 8 m/s, made of plain numbers, with two cameras and a parked car; for damaged recordings."""
    start_ns = 1_700_000_000 * SECOND_NS

    def poses_at(stamps: Int64) -> Poses:
        seconds = (np.asarray(stamps) - start_ns) * 1e-9
        position = np.stack([8.0 * seconds - 40.0, np.zeros(len(seconds)), np.full(len(seconds), 0.5)], axis=1)
        return Poses(np.tile((1.0, 0.0, 0.0, 0.0), (len(seconds), 1)), position)

    box_ns = start_ns + np.arange(0, 12 * SECOND_NS + 1, 4 * SECOND_NS)
    parked = Poses(np.tile((1.0, 0.0, 0.0, 0.0), (len(box_ns), 1)), np.tile((5.0, 3.0, 1.3), (len(box_ns), 1)))
    names = ("front_wide", "rear")
    backward = (0.5, -0.5, -0.5, 0.5)
    return StreetDrive(
        name="straight",
        vehicle="car-1",
        light="day",
        weather="clear",
        pose_ns=start_ns + np.arange(0, 12 * SECOND_NS + 1, SECOND_NS // 4),
        poses_at=poses_at,
        cameras={name: _pinhole(number) for number, name in enumerate(names)},
        ego_SE3_camera={
            "front_wide": Poses(np.array([_FORWARD]), np.array([[1.5, 0.0, 1.6]])),
            "rear": Poses(np.array([backward]), np.array([[-0.5, 0.0, 1.6]])),
        },
        image_ns={
            name: start_ns + 2_000 + 7_000_000 * number + np.arange(0, 12 * SECOND_NS, 3 * SECOND_NS // 2)
            for number, name in enumerate(names)
        },
        box_ns=box_ns,
        objects=(StreetObject("7", "car", (4.5, 1.9, 1.6), parked),),
    )
