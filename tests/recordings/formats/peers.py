"""The inputs of other toolkits that read the same files as our readers; ``tests/peers`` holds what they read."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_exp
from tests.recordings.formats.argoverse2 import write_argoverse2
from tests.recordings.formats.kitti import as_raw, from_first_camera, write_kitti_odometry, write_kitti_raw
from tests.recordings.formats.kitti360 import CAMERAS as RECTIFIED
from tests.recordings.formats.kitti360 import FISHEYES, write_kitti360
from tests.recordings.formats.nuplan import write_nuplan
from tests.recordings.formats.nuscenes import write_nuscenes
from tests.recordings.formats.street import StreetDrive, StreetObject, synth_drives
from tests.recordings.formats.video_gps import Fixes, camm5, camm6, gps5, gps9, write_video
from tests.recordings.formats.waymo import write_waymo

RESULTS = Path(__file__).resolve().parents[2] / "peers"
CAMERAS = ("front_wide", "front_left", "rear_right")


def peer_drive(offset_m: tuple[float, float, float]) -> StreetDrive:
    """The drive that toolkits read."""
    return synth_drives()[0].placed(offset_m).with_cameras(CAMERAS)


def nuscenes_input(folder: Path) -> Path:
    """A folder with one scene, in a map of no known place."""
    shutil.rmtree(folder, ignore_errors=True)
    return write_nuscenes(folder, [peer_drive((1620.0, 1180.0, 0.0))], location="synthetic-street")


def argoverse2_input(folder: Path) -> Path:
    """A folder with one log in Pittsburgh."""
    shutil.rmtree(folder, ignore_errors=True)
    return write_argoverse2(folder, peer_drive((5122.0, 2432.0, 66.0)))


def kitti360_input(folder: Path) -> Path:
    """A folder with one drive of three frames: four cameras, moving boxes and a parked one."""
    shutil.rmtree(folder, ignore_errors=True)
    names = (*RECTIFIED, *FISHEYES)
    drive = synth_drives()[0].placed((1107.0, 3826.0, 115.0)).with_cameras(names)
    chosen = [4, 12, 20]
    stamps = drive.box_ns[chosen]
    # The dataset has no vans.
    objects = tuple(
        replace(one, category={"van": "truck"}.get(one.category, one.category), world_SE3_box=one.world_SE3_box[chosen])
        for one in drive.objects
    )
    beside = Poses(quaternion_exp([[0.02, -0.03, 1.1]]), np.array([[12.0, 4.0, 0.7]]))
    parked = StreetObject("parked", "car", (4.5, 1.9, 1.6), drive.poses_at(stamps[1:2]) @ beside)
    raster = {name: replace(drive.cameras[name], width_px=1400, height_px=1400) for name in FISHEYES}
    drive = replace(
        drive,
        name="2013_05_28_drive_0000_sync",
        image_ns=dict.fromkeys(names, stamps),
        pose_ns=stamps,
        box_ns=stamps,
        objects=objects,
        cameras={**drive.cameras, **raster},
    )
    return write_kitti360(folder, [drive], parked=[parked], boxes=True)


def py123d_input(folder: Path) -> Path:
    """The folder of `kitti360_input`, with stamps and empty points of the lidar, which py123d asks for."""
    root = kitti360_input(folder)
    (images,) = (root / "data_2d_raw").iterdir()
    lidar = root / "data_3d_raw" / images.name / "velodyne_points"
    (lidar / "data").mkdir(parents=True)
    shutil.copyfile(images / "image_00" / "timestamps.txt", lidar / "timestamps.txt")
    for file in (images / "image_00" / "data_rect").iterdir():
        (lidar / "data" / f"{file.stem}.bin").touch()
    (root / "calibration" / "calib_cam_to_velo.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    return root


def waymo_input(folder: Path) -> Path:
    """A folder with one segment; the cameras are distorted, and their shutters roll."""
    shutil.rmtree(folder, ignore_errors=True)
    drive = synth_drives()[0].placed((220.0, -43.0, 30.0))
    return write_waymo(folder, [drive.with_cameras(("front_wide", "front_left", "rear_right"))])


def nuplan_input(folder: Path) -> Path:
    """A folder with one log in Las Vegas, and the images of three cameras."""
    shutil.rmtree(folder, ignore_errors=True)
    return write_nuplan(folder, peer_drive((664_400.0, 3_998_300.0, 605.0)).upright())


def pykitti_input(folder: Path) -> Path:
    """A folder with a sequence of KITTI odometry and a drive of KITTI raw, of four cameras and three frames each."""
    shutil.rmtree(folder, ignore_errors=True)
    drive = synth_drives()[0].with_cameras(("front_wide",))
    drive = replace(drive, image_ns={"front_wide": drive.image_ns["front_wide"][4:13:4]})
    write_kitti_odometry(folder / "odometry", {"03": from_first_camera(drive)})
    drive = synth_drives()[0]
    objects = tuple(replace(one, world_SE3_box=one.world_SE3_box[4:13:4]) for one in drive.objects)
    write_kitti_raw(folder / "raw", as_raw(replace(drive, box_ns=drive.box_ns[4:13:4], objects=objects)))
    return folder


def mapillary_tools_input(folder: Path) -> Path:
    """A folder with videos of four kinds of fixes, three seconds each."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    fixes = Fixes(seconds=3)
    write_video(folder / "gps5.mp4", "gpmd", gps5(fixes), 1000)
    write_video(folder / "gps9.mp4", "gpmd", gps9(fixes, beside=False), 1000)
    write_video(folder / "camm5.mp4", "camm", camm5(fixes), 62, created_ns=fixes.start_ns)
    write_video(folder / "camm6.mp4", "camm", camm6(fixes), 31, created_ns=fixes.start_ns)
    return folder


INPUTS: dict[str, Callable[[Path], Path]] = {
    "nuscenes": nuscenes_input,
    "argoverse2": argoverse2_input,
    "kitti360": kitti360_input,
    "mapillary_tools": mapillary_tools_input,
    "nuplan": nuplan_input,
    "py123d": py123d_input,
    "pykitti": pykitti_input,
    "waymo": waymo_input,
}


def result(name: str) -> Any:
    """Return what a toolkit read."""
    return json.loads((RESULTS / name / "result.json").read_text())
