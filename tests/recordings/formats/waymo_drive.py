"""The drive as Waymo's recordings can state it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mirror.geometry.cameras.camera import Camera
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_exp
from tests.recordings.formats.street import StreetDrive, StreetObject
from tests.recordings.formats.waymo import CAMERAS, DISTORTION

OFFSET_M = (22_000.0, -4_300.0, 30.0)


def prepared(drive: StreetDrive) -> StreetDrive:
    """The drive with distorted lenses, and boxes that are level in the vehicle's frame."""
    drive = drive.placed(OFFSET_M).with_cameras(tuple(CAMERAS))
    lenses = {
        name: Camera(
            "brown_conrady", c.width_px, c.height_px, c.fx_px, c.fy_px, c.cx_px, c.cy_px, tuple(DISTORTION.values())
        )
        for name, c in drive.cameras.items()
    }
    ego = drive.poses_at(drive.box_ns)

    def level(one: StreetObject) -> StreetObject:
        seen = ego.inverse() @ one.world_SE3_box
        ahead = matrix_from_quaternion(seen.rotation)[:, :, 0]
        turn = quaternion_exp(np.outer(np.arctan2(ahead[:, 1], ahead[:, 0]), (0.0, 0.0, 1.0)))
        return replace(one, world_SE3_box=ego @ Poses(turn, seen.translation))

    return replace(drive, cameras=lenses, objects=tuple(level(one) for one in drive.objects))
