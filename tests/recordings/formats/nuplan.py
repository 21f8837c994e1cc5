"""Writes a drive as a nuPlan log: a SQLite database, and its camera blobs."""

from __future__ import annotations

import pickle
import sqlite3
from contextlib import closing
from hashlib import md5
from pathlib import Path

import numpy as np

from mirror.geometry.quaternions import matrix_from_quaternion
from tests.recordings.formats.street import StreetDrive

CHANNELS = {
    "front_wide": "CAM_F0",
    "front_left": "CAM_L0",
    "front_right": "CAM_R0",
    "front_narrow": "CAM_L1",
    "rear_left": "CAM_L2",
    "rear_right": "CAM_R2",
    "rear": "CAM_B0",
}
DISTORTION = (-0.35, 0.16, 0.0003, -0.0002, -0.04)
_SCHEMA = """
CREATE TABLE log (token BLOB PRIMARY KEY, vehicle_name TEXT, date TEXT, timestamp INTEGER, logfile TEXT,
    location TEXT, map_version TEXT);
CREATE TABLE ego_pose (token BLOB PRIMARY KEY, timestamp INTEGER, x FLOAT, y FLOAT, z FLOAT, qw FLOAT, qx FLOAT,
    qy FLOAT, qz FLOAT, vx FLOAT, vy FLOAT, vz FLOAT, epsg INTEGER, log_token BLOB);
CREATE TABLE camera (token BLOB PRIMARY KEY, log_token BLOB, channel TEXT, model TEXT, translation BLOB, rotation BLOB,
    intrinsic BLOB, distortion BLOB, width INTEGER, height INTEGER);
CREATE TABLE image (token BLOB PRIMARY KEY, next_token BLOB, prev_token BLOB, ego_pose_token BLOB, camera_token BLOB,
    filename_jpg TEXT, timestamp INTEGER);
CREATE TABLE lidar_pc (token BLOB PRIMARY KEY, ego_pose_token BLOB, filename TEXT, timestamp INTEGER);
CREATE TABLE lidar_box (token BLOB PRIMARY KEY, lidar_pc_token BLOB, track_token BLOB, x FLOAT, y FLOAT, z FLOAT,
    width FLOAT, length FLOAT, height FLOAT, vx FLOAT, vy FLOAT, vz FLOAT, yaw FLOAT, confidence FLOAT);
CREATE TABLE track (token BLOB PRIMARY KEY, category_token BLOB, width FLOAT, length FLOAT, height FLOAT);
CREATE TABLE category (token BLOB PRIMARY KEY, name TEXT, description TEXT);
"""


def token(*words: object) -> bytes:
    """A token of eight bytes."""
    return md5(" ".join(map(str, words)).encode()).digest()[:8]


def write_nuplan(root: Path, drive: StreetDrive, *, epsg: int = 32611, blobs: bool = True) -> Path:
    """Write a log, and return its database. The drive's world is the UTM zone; objects stand upright."""
    file = root / "splits" / "mini" / f"{drive.name}.db"
    file.parent.mkdir(parents=True, exist_ok=True)
    with closing(sqlite3.connect(file)) as database:
        database.executescript(_SCHEMA)
        log = token("log", drive.name)
        log_row = (log, drive.vehicle, "2021-05-12", 0, drive.name, "las_vegas", "us-nv-las-vegas-strip")
        database.execute("INSERT INTO log VALUES (?, ?, ?, ?, ?, ?, ?)", log_row)
        stamps = np.unique(np.concatenate([drive.pose_ns, *drive.image_ns.values()]))
        poses = drive.poses_at(stamps)
        for row, stamp in enumerate((stamps // 1_000).tolist()):
            values = [*poses.translation[row].tolist(), *poses.rotation[row].tolist(), 0.0, 0.0, 0.0]
            database.execute(
                f"INSERT INTO ego_pose VALUES ({', '.join('?' * 14)})",
                (token("pose", stamp), stamp, *values, epsg, log),
            )
        for name in drive.cameras:
            _write_camera(database, root, drive, name, blobs=blobs)
        _write_boxes(database, drive)
        database.commit()
    return file


def _write_camera(database: sqlite3.Connection, root: Path, drive: StreetDrive, name: str, *, blobs: bool) -> None:
    lens, mounting, channel = drive.cameras[name], drive.ego_SE3_camera[name], CHANNELS[name]
    matrix = [[lens.fx_px, 0.0, lens.cx_px - 0.5], [0.0, lens.fy_px, lens.cy_px - 0.5], [0.0, 0.0, 1.0]]
    blobs_of_row = [
        pickle.dumps(value)
        for value in (mounting.translation[0].tolist(), mounting.rotation[0].tolist(), matrix, np.array(DISTORTION))
    ]
    database.execute(
        f"INSERT INTO camera VALUES ({', '.join('?' * 10)})",
        (token("camera", channel), token("log", drive.name), channel, "", *blobs_of_row, lens.width_px, lens.height_px),
    )
    for index, stamp in enumerate((drive.image_ns[name] // 1_000).tolist()):
        image = token("image", channel, stamp)
        filename = f"{drive.name}/{channel}/{image.hex()}.jpg"
        database.execute(
            "INSERT INTO image VALUES (?, NULL, NULL, ?, ?, ?, ?)",
            (image, token("pose", stamp), token("camera", channel), filename, stamp),
        )
        if blobs:
            file = root / "sensor_blobs" / filename
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(drive.image(name, index))


def _write_boxes(database: sqlite3.Connection, drive: StreetDrive) -> None:
    for stamp in (drive.box_ns // 1_000).tolist():
        row = (token("lidar", stamp), token("pose", stamp), f"{drive.name}/MergedPointCloud/x.pcd", stamp)
        database.execute("INSERT INTO lidar_pc VALUES (?, ?, ?, ?)", row)
    for one in drive.objects:
        length, width, height = one.size_m
        track = token("track", one.track_id)
        category = (token("category", "vehicle"), "vehicle", "")
        database.execute("INSERT OR IGNORE INTO category VALUES (?, ?, ?)", category)
        database.execute("INSERT INTO track VALUES (?, ?, ?, ?, ?)", (track, category[0], width, length, height))
        for row, stamp in enumerate((drive.box_ns // 1_000).tolist()):
            pose = one.world_SE3_box[row]
            ahead = matrix_from_quaternion(pose.rotation)[0, :, 0]
            values = [*pose.translation[0].tolist(), width, length, height, 3.0, -1.0, 0.25]
            yaw = float(np.arctan2(ahead[1], ahead[0]))
            database.execute(
                f"INSERT INTO lidar_box VALUES ({', '.join('?' * 14)})",
                (token("box", one.track_id, stamp), token("lidar", stamp), track, *values, yaw, 0.75),
            )
