"""Writes drives as a nuScenes folder: 13 tables, ``samples`` and ``sweeps``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from hashlib import md5
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.recordings.formats.street import StreetDrive

CHANNELS = {
    "front_wide": "CAM_FRONT",
    "front_left": "CAM_FRONT_LEFT",
    "front_right": "CAM_FRONT_RIGHT",
    "rear_left": "CAM_BACK_LEFT",
    "rear_right": "CAM_BACK_RIGHT",
    "rear": "CAM_BACK",
}
CATEGORIES = {"car": "vehicle.car", "van": "vehicle.car", "truck": "vehicle.truck", "bus": "vehicle.bus.rigid"}
ATTRIBUTES = ((), ("vehicle.moving",), ("vehicle.parked",))
DECIMALS = 9
Row = dict[str, Any]


def token(*words: object) -> str:
    """A token of 32 hexadecimal digits."""
    return md5(" ".join(map(str, words)).encode()).hexdigest()


def attributes_at(row: int) -> tuple[str, ...]:
    """Attributes of the boxes of a drive's row of stamps."""
    return ATTRIBUTES[row % len(ATTRIBUTES)]


def write_nuscenes(
    root: Path, drives: Sequence[StreetDrive], *, version: str = "v1.0-mini", location: str = "boston-seaport"
) -> Path:
    """Write one scene for each drive, and return the folder.

    The drives' world is the map's frame. Drives have the six cameras of nuScenes; others are left out.
    """
    tables: dict[str, list[Row]] = {name: [] for name in _TABLES}
    tables["attribute"] = [
        {"token": token("attribute", name), "name": name, "description": ""} for names in ATTRIBUTES for name in names
    ]
    tables["visibility"] = [{"token": "4", "level": "v80-100", "description": ""}]
    tables["map"] = [
        {
            "token": token("map"),
            "category": "semantic_prior",
            "filename": f"maps/{token('map')}.png",
            "log_tokens": [token("log", drive.name) for drive in drives],
        }
    ]
    cameras = [CHANNELS[name] for name in drives[0].cameras if name in CHANNELS]
    for channel in (*cameras, "LIDAR_TOP"):
        modality = "camera" if channel.startswith("CAM") else "lidar"
        tables["sensor"].append({"token": token("sensor", channel), "channel": channel, "modality": modality})
    categories = {CATEGORIES.get(one.category, one.category) for drive in drives for one in drive.objects}
    for name in sorted(categories):
        tables["category"].append({"token": token("category", name), "name": name, "description": ""})
    for number, drive in enumerate(drives):
        _write_scene(root, tables, drive, f"scene-{number + 1:04d}", location)
    (root / version).mkdir(parents=True, exist_ok=True)
    for name, rows in tables.items():
        (root / version / f"{name}.json").write_text(json.dumps(rows, indent=0))
    (root / "maps").mkdir(exist_ok=True)
    blank = cv2.imencode(".png", np.zeros((10, 10), np.uint8))[1].tobytes()
    (root / "maps" / f"{token('map')}.png").write_bytes(blank)
    return root


_TABLES = (
    "attribute", "calibrated_sensor", "category", "ego_pose", "instance", "log", "map", "sample", "sample_annotation",
    "sample_data", "scene", "sensor", "visibility",
)  # fmt: skip


def _write_scene(root: Path, tables: dict[str, list[Row]], drive: StreetDrive, name: str, location: str) -> None:
    words = [
        "Parked cars",
        *(["rain"] if drive.weather == "rain" else []),
        *(["night"] if drive.light == "night" else []),
    ]
    log = token("log", drive.name)
    tables["log"].append(
        {
            "token": log,
            "logfile": f"n015-{drive.name}",
            "vehicle": drive.vehicle,
            "date_captured": str(drive.pose_ns[0].astype("datetime64[ns]").astype("datetime64[D]")),
            "location": location,
        }
    )
    samples = [token("sample", drive.name, stamp) for stamp in drive.box_ns.tolist()]
    tables["scene"].append(
        {
            "token": token("scene", drive.name),
            "log_token": log,
            "nbr_samples": len(samples),
            "first_sample_token": samples[0],
            "last_sample_token": samples[-1],
            "name": name,
            "description": ", ".join(words),
        }
    )
    links = zip(["", *samples[:-1]], samples, [*samples[1:], ""])
    for stamp, (before, this, after) in zip((drive.box_ns // 1_000).tolist(), links):
        tables["sample"].append(
            {
                "token": this,
                "timestamp": stamp,
                "prev": before,
                "next": after,
                "scene_token": token("scene", drive.name),
            }
        )
    _write_sensors(root, tables, drive, samples)
    _write_boxes(tables, drive, samples)


def _write_sensors(root: Path, tables: dict[str, list[Row]], drive: StreetDrive, samples: list[str]) -> None:
    streams = {CHANNELS[name]: (name, stamps) for name, stamps in drive.image_ns.items() if name in CHANNELS}
    for channel, (camera, stamps) in {**streams, "LIDAR_TOP": (None, drive.pose_ns)}.items():
        calibrated = token("calibrated_sensor", drive.name, channel)
        mounting = [[1.0, 0.0, 0.0, 0.0], [0.9, 0.0, 1.8]]
        matrix: list[list[float]] = []
        width = height = 0
        if camera is not None:
            lens, pose = drive.cameras[camera], drive.ego_SE3_camera[camera]
            mounting = [pose.rotation[0].tolist(), pose.translation[0].tolist()]
            # The devkit has the centre of the first pixel at 0.
            matrix = [[lens.fx_px, 0.0, lens.cx_px - 0.5], [0.0, lens.fy_px, lens.cy_px - 0.5], [0.0, 0.0, 1.0]]
            width, height = lens.width_px, lens.height_px
        tables["calibrated_sensor"].append(
            {
                "token": calibrated,
                "sensor_token": token("sensor", channel),
                "translation": mounting[1],
                "rotation": mounting[0],
                "camera_intrinsic": matrix,
            }
        )
        keys = [int(np.argmin(np.abs(stamps - stamp))) for stamp in drive.box_ns]
        poses = drive.poses_at(stamps)
        tokens = [token("data", drive.name, channel, stamp) for stamp in stamps.tolist()]
        for row, stamp in enumerate((stamps // 1_000).tolist()):
            folder = "samples" if row in keys else "sweeps"
            kind = "jpg" if camera is not None else "pcd"
            suffix = "jpg" if camera is not None else "pcd.bin"
            filename = f"{folder}/{channel}/n015-{drive.name}__{channel}__{stamp}.{suffix}"
            tables["ego_pose"].append(
                {
                    "token": tokens[row],
                    "timestamp": stamp,
                    "rotation": poses.rotation[row].round(12).tolist(),
                    "translation": poses.translation[row].round(DECIMALS).tolist(),
                }
            )
            tables["sample_data"].append(
                {
                    "token": tokens[row],
                    "sample_token": samples[int(np.argmin(np.abs(drive.box_ns - stamps[row])))],
                    "ego_pose_token": tokens[row],
                    "calibrated_sensor_token": calibrated,
                    "timestamp": stamp,
                    "fileformat": kind,
                    "is_key_frame": row in keys,
                    "height": height,
                    "width": width,
                    "filename": filename,
                    "prev": tokens[row - 1] if row else "",
                    "next": tokens[row + 1] if row + 1 < len(tokens) else "",
                }
            )
            if camera is not None:
                (root / filename).parent.mkdir(parents=True, exist_ok=True)
                (root / filename).write_bytes(drive.image(camera, row))


def _write_boxes(tables: dict[str, list[Row]], drive: StreetDrive, samples: list[str]) -> None:
    for one in drive.objects:
        tokens = [token("box", drive.name, one.track_id, row) for row in range(len(samples))]
        tables["instance"].append(
            {
                "token": token("instance", drive.name, one.track_id),
                "category_token": token("category", CATEGORIES.get(one.category, one.category)),
                "nbr_annotations": len(tokens),
                "first_annotation_token": tokens[0],
                "last_annotation_token": tokens[-1],
            }
        )
        length, width, height = one.size_m
        for row, sample in enumerate(samples):
            pose = one.world_SE3_box[row]
            tables["sample_annotation"].append(
                {
                    "token": tokens[row],
                    "sample_token": sample,
                    "instance_token": token("instance", drive.name, one.track_id),
                    "visibility_token": "4",
                    "attribute_tokens": [token("attribute", name) for name in attributes_at(row)],
                    "translation": pose.translation[0].round(DECIMALS).tolist(),
                    "size": [width, length, height],
                    "rotation": pose.rotation[0].round(12).tolist(),
                    "prev": tokens[row - 1] if row else "",
                    "next": tokens[row + 1] if row + 1 < len(tokens) else "",
                    "num_lidar_pts": 5,
                    "num_radar_pts": 0,
                }
            )
