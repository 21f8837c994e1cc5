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
    qy FLOAT, qz FLOAT, vx FLOAT, vy FLOAT, vz FLOAT, acceleration_x FLOAT, acceleration_y FLOAT, acceleration_z FLOAT,
    angular_rate_x FLOAT, angular_rate_y FLOAT, angular_rate_z FLOAT, epsg INTEGER, log_token BLOB);
CREATE TABLE camera (token BLOB PRIMARY KEY, log_token BLOB, channel TEXT, model TEXT, translation BLOB, rotation BLOB,
    intrinsic BLOB, distortion BLOB, width INTEGER, height INTEGER);
CREATE TABLE image (token BLOB PRIMARY KEY, next_token BLOB, prev_token BLOB, ego_pose_token BLOB, camera_token BLOB,
    filename_jpg TEXT, timestamp INTEGER);
CREATE TABLE lidar (token BLOB PRIMARY KEY, log_token BLOB, channel TEXT, model TEXT, translation BLOB, rotation BLOB);
CREATE TABLE lidar_pc (token BLOB PRIMARY KEY, next_token BLOB, prev_token BLOB, ego_pose_token BLOB, lidar_token BLOB,
    scene_token BLOB, filename TEXT, timestamp INTEGER);
CREATE TABLE lidar_box (token BLOB PRIMARY KEY, lidar_pc_token BLOB, track_token BLOB, next_token BLOB, prev_token BLOB,
    x FLOAT, y FLOAT, z FLOAT, width FLOAT, length FLOAT, height FLOAT, vx FLOAT, vy FLOAT, vz FLOAT, yaw FLOAT,
    confidence FLOAT);
CREATE TABLE track (token BLOB PRIMARY KEY, category_token BLOB, width FLOAT, length FLOAT, height FLOAT);
CREATE TABLE category (token BLOB PRIMARY KEY, name TEXT, description TEXT);
CREATE TABLE scene (token BLOB PRIMARY KEY, log_token BLOB, name TEXT, goal_ego_pose_token BLOB, roadblock_ids TEXT);
CREATE TABLE scenario_tag (token BLOB PRIMARY KEY, lidar_pc_token BLOB, type TEXT, agent_track_token BLOB);
CREATE TABLE traffic_light_status (token BLOB PRIMARY KEY, lidar_pc_token BLOB, lane_connector_id INTEGER, status TEXT);
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
        _insert(
            database,
            "log",
            token=log,
            vehicle_name=drive.vehicle,
            date="2021-05-12",
            timestamp=0,
            logfile=drive.name,
            location="las_vegas",
            map_version="us-nv-las-vegas-strip",
        )
        _insert(database, "scene", token=token("scene", drive.name), log_token=log, name="scene-001", roadblock_ids="")
        _insert(database, "lidar", token=token("lidar", drive.name), log_token=log, channel="MergedPointCloud")
        stamps = np.unique(np.concatenate([drive.pose_ns, *drive.image_ns.values()]))
        poses = drive.poses_at(stamps)
        for row, stamp in enumerate((stamps // 1_000).tolist()):
            _insert(
                database,
                "ego_pose",
                token=token("pose", stamp),
                timestamp=stamp,
                **dict(zip("xyz", poses.translation[row].tolist())),
                **dict(zip(("qw", "qx", "qy", "qz"), poses.rotation[row].tolist())),
                epsg=epsg,
                log_token=log,
            )
        for name in drive.cameras:
            _write_camera(database, root, drive, name, blobs=blobs)
        _write_boxes(database, drive)
        database.commit()
    return file


def _write_camera(database: sqlite3.Connection, root: Path, drive: StreetDrive, name: str, *, blobs: bool) -> None:
    lens, mounting, channel = drive.cameras[name], drive.ego_SE3_camera[name], CHANNELS[name]
    matrix = [[lens.fx_px, 0.0, lens.cx_px - 0.5], [0.0, lens.fy_px, lens.cy_px - 0.5], [0.0, 0.0, 1.0]]
    camera = token("camera", channel)
    _insert(
        database,
        "camera",
        token=camera,
        log_token=token("log", drive.name),
        channel=channel,
        model="",
        translation=pickle.dumps(mounting.translation[0].tolist()),
        rotation=pickle.dumps(mounting.rotation[0].tolist()),
        intrinsic=pickle.dumps(matrix),
        distortion=pickle.dumps(np.array(DISTORTION)),
        width=lens.width_px,
        height=lens.height_px,
    )
    for index, stamp in enumerate((drive.image_ns[name] // 1_000).tolist()):
        image = token("image", channel, stamp)
        filename = f"{drive.name}/{channel}/{image.hex()}.jpg"
        _insert(
            database,
            "image",
            token=image,
            ego_pose_token=token("pose", stamp),
            camera_token=camera,
            filename_jpg=filename,
            timestamp=stamp,
        )
        if blobs:
            file = root / "sensor_blobs" / filename
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(drive.image(name, index))


def _write_boxes(database: sqlite3.Connection, drive: StreetDrive) -> None:
    stamps = (drive.box_ns // 1_000).tolist()
    for stamp in stamps:
        _insert(
            database,
            "lidar_pc",
            token=token("lidar", stamp),
            ego_pose_token=token("pose", stamp),
            lidar_token=token("lidar", drive.name),
            scene_token=token("scene", drive.name),
            filename=f"{drive.name}/MergedPointCloud/x.pcd",
            timestamp=stamp,
        )
    category = token("category", "vehicle")
    _insert(database, "category", token=category, name="vehicle", description="")
    for one in drive.objects:
        track = token("track", one.track_id)
        size = dict(zip(("length", "width", "height"), one.size_m))
        _insert(database, "track", token=track, category_token=category, **size)
        names = [None, *(token("box", one.track_id, stamp) for stamp in stamps), None]
        for row, stamp in enumerate(stamps):
            pose = one.world_SE3_box[row]
            ahead = matrix_from_quaternion(pose.rotation)[0, :, 0]
            _insert(
                database,
                "lidar_box",
                token=names[row + 1],
                lidar_pc_token=token("lidar", stamp),
                track_token=track,
                next_token=names[row + 2],
                prev_token=names[row],
                **dict(zip("xyz", pose.translation[0].tolist())),
                **size,
                vx=3.0,
                vy=-1.0,
                vz=0.25,
                yaw=float(np.arctan2(ahead[1], ahead[0])),
                confidence=0.75,
            )


def _insert(database: sqlite3.Connection, table: str, **values: object) -> None:
    """Insert a row; columns without a value are null."""
    marks = ", ".join("?" * len(values))
    database.execute(f"INSERT INTO {table} ({', '.join(values)}) VALUES ({marks})", tuple(values.values()))
