"""Checks the outcome of a damaged recording.

A damaged recording may be refused by name; then the dataset must not change. Or it may be ingested, perhaps without
some rows, which are counted; then every value must be in its documented range, and rows that the damage did not touch
must equal those of the pristine recording.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mirror.dataset.layout import Layout
from mirror.geometry.cameras import camera_from_row
from mirror.recordings.registry import open_recording
from mirror.schema.files import read_table
from mirror.schema.tables import BOXES, CALIBRATIONS, EGO_POSES, IMAGES
from tests.fuzz.bases import Base

POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
POSES, CAMERAS, SHOTS, OBJECTS = "ego_poses", "calibrations", "images", "boxes"
ALL = frozenset((POSES, CAMERAS, SHOTS, OBJECTS))
# The tables that depend on a file, by reader and prefix of the file's path; no table depends on other files.
DEPENDENT_TABLES: dict[str, dict[str, frozenset[str]]] = {
    "folder": {
        "poses.csv": frozenset({POSES}),
        "recording.json": ALL,
        "calibrations/": frozenset({CAMERAS}),
        "boxes.parquet": frozenset({OBJECTS}),
        "images/": frozenset({SHOTS}),
    },
    "csv": {"": frozenset({POSES})},
    "boreas": {
        "camera_poses.csv": frozenset({POSES}),
        "calib/": frozenset({CAMERAS}),
        "camera/": frozenset({SHOTS}),
    },
    "dgp": {
        "scene_": ALL,
        "calibration/": ALL,
        "ontology/": frozenset({OBJECTS}),
        "bounding_box_3d/": frozenset({OBJECTS}),
        "rgb/": frozenset({SHOTS}),
    },
    "comma2k19": {"": frozenset({POSES})},
    "mcap": {"": ALL},
    "rosbag2": {"": ALL},
    "nuscenes": {"v1.0-mini/": ALL, "samples/": frozenset({SHOTS}), "sweeps/": frozenset({SHOTS})},
    "argoverse2": {
        "city_SE3_egovehicle": frozenset({POSES}),
        "calibration/": frozenset({CAMERAS}),
        "annotations": frozenset({OBJECTS}),
        "sensors/": frozenset({SHOTS}),
        "map/": ALL,
    },
    "colmap": {"sparse/": ALL, "images/": frozenset({SHOTS})},
    "nuplan": {"splits/": ALL, "sensor_blobs/": frozenset({SHOTS})},
    "kitti360": {
        "data_poses/": frozenset({POSES, OBJECTS}),
        "calibration/": frozenset({CAMERAS}),
        "data_2d_raw/": frozenset({POSES, SHOTS, OBJECTS}),
        "data_3d_bboxes/": frozenset({OBJECTS}),
    },
    "kitti_odometry": {
        "poses/": frozenset({POSES}),
        "sequences/03/times": frozenset({POSES, SHOTS}),
        "sequences/03/calib": frozenset({CAMERAS}),
        "sequences/03/image_": frozenset({SHOTS, CAMERAS}),
    },
    "video_gps": {"": frozenset({POSES})},
    "kitti_raw": {
        "calib_imu_to_velo": frozenset({CAMERAS, OBJECTS}),
        "calib_": frozenset({CAMERAS}),
        "2011_09_26_drive_0009_sync/oxts/": frozenset({POSES}),
        "2011_09_26_drive_0009_sync/image_00/timestamps": frozenset({SHOTS, OBJECTS}),
        "2011_09_26_drive_0009_sync/image_00/data": frozenset({SHOTS}),
        "2011_09_26_drive_0009_sync/tracklet": frozenset({OBJECTS}),
    },
    "waymo": {
        "vehicle_pose/": frozenset({POSES}),
        "camera_image/": frozenset({POSES, SHOTS, CAMERAS}),
        "camera_calibration/": frozenset({CAMERAS}),
        "lidar_box/": frozenset({OBJECTS}),
    },
    "ncore": {
        "straight.ncore4.zarr.itar": ALL,
        "straight.ncore4.zarr/": frozenset({POSES, CAMERAS}),
        "straight.ncore4-cameras": frozenset({SHOTS}),
        "straight.ncore4-labels": frozenset({OBJECTS}),
    },
}
KEYS = {
    POSES: ("timestamp_ns",),
    CAMERAS: ("camera", "stage"),
    SHOTS: ("camera", "timestamp_ns"),
    OBJECTS: ("timestamp_ns", "track_id"),
}
COMPARED = {
    POSES: ("tx_m", "ty_m", "tz_m", "longitude_deg", "latitude_deg"),
    CAMERAS: ("model", "width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "distortion", *POSE),
    SHOTS: ("exposure_start_ns", "exposure_end_ns", "width_px", "height_px", "sha256", "byte_length"),
    OBJECTS: ("category", *POSE, "length_m", "width_m", "height_m", "source"),
}
Rows = dict[str, list[dict[str, Any]]]


@dataclass(frozen=True)
class Reference:
    """The result of a pristine recording.

    Attributes:
        base: the recording.
        rows: rows of its only traversal, by table.
        stamps_ns: (N,) stamps of its track, in the order of the file's rows.
    """

    base: Base
    rows: Rows
    stamps_ns: np.ndarray


def rows_of(dataset: Path, traversal: str) -> Rows:
    """Read all tables of a traversal."""
    layout = Layout(dataset)
    found = {
        table.name: read_table(layout.recorded(traversal) / f"{table.name}.parquet", table).to_pylist()
        for table in (EGO_POSES, CALIBRATIONS, IMAGES)
    }
    boxes = sorted(layout.traversal(traversal).glob("layers/boxes/*/boxes.parquet"))
    return {**found, OBJECTS: [row for file in boxes for row in read_table(file, BOXES).to_pylist()]}


def faults_of_values(rows: Rows) -> list[str]:
    """List values outside their documented ranges."""
    faults = []
    for name in (POSES, CAMERAS, OBJECTS):
        pose = np.array([[row[column] for column in POSE] for row in rows[name]]).reshape(-1, 7)
        if not np.isfinite(pose).all() or (np.abs(np.linalg.norm(pose[:, :4], axis=1) - 1.0) > 1e-6).any():
            faults.append(f"{name}: an invalid pose")
    for row in rows[POSES]:
        lon, lat, sigma = row["longitude_deg"], row["latitude_deg"], row["sigma_m"]
        if lon is not None and not (-180 <= lon <= 180 and -90 <= lat <= 90):
            faults.append(f"ego_poses: {lon}, {lat}")
        if sigma is not None and not 0 <= sigma < np.inf:
            faults.append(f"ego_poses: sigma {sigma}")
    if (np.diff([row["timestamp_ns"] for row in rows[POSES]]) <= 0).any():
        faults.append("ego_poses: stamps do not ascend")
    rasters = {}
    for row in rows[CAMERAS]:
        camera = camera_from_row(row)
        rasters[row["camera"]] = (camera.width_px, camera.height_px)
        if not np.isfinite(camera.project(np.array([[0.0, 0.0, 1.0]])).uv_px).all():
            faults.append("calibrations: the optical axis has no pixel")
    for row in rows[SHOTS]:
        size = (row["width_px"], row["height_px"])
        if rasters.get(row["camera"], size) != size or min(size) < 1:
            faults.append(f"images: {size} of {row['camera']}")
        if not row["exposure_start_ns"] <= row["timestamp_ns"] <= row["exposure_end_ns"]:
            faults.append("images: a stamp outside of its exposure")
    for row in rows[OBJECTS]:
        if not all(0 < row[name] < np.inf for name in ("length_m", "width_m", "height_m")):
            faults.append("boxes: a box without size")
    return faults


def faults_of_untouched(reference: Reference, rows: Rows, damaged: Base, files: set[str]) -> list[str]:
    """List rows that changed although the damage did not touch them.

    Args:
        reference: the result of the pristine recording.
        rows: rows of the damaged recording's traversal.
        damaged: the damaged recording.
        files: the files that differ, relative to the recording.
    """
    touched: set[str] = set()
    for prefix, tables in DEPENDENT_TABLES[damaged.reader].items():
        if any(file.startswith(prefix) for file in files):
            touched |= tables
    faults = []
    for table, key in KEYS.items():
        if table in touched and table != POSES:
            continue
        before = {tuple(row[name] for name in key): row for row in reference.rows[table]}
        if table in touched:
            kept = untouched_stamps(reference, damaged, files)
            before = {(stamp,): row for (stamp,), row in before.items() if stamp in kept}
        for row in rows[table]:
            other = before.get(tuple(row[name] for name in key))
            if other is not None and any(row[name] != other[name] for name in COMPARED[table]):
                faults.append(f"{table}: {[row[name] for name in key]} has changed")
    return faults


def untouched_stamps(reference: Reference, damaged: Base, files: set[str]) -> set[int]:
    """Stamps of the pose rows that are unchanged and that no other row of the damaged recording has."""
    rows = np.zeros(len(reference.stamps_ns), np.bool_)
    start = 0
    for name in pose_files(reference.base):
        before, after = (reference.base.path / name).read_bytes(), _bytes(damaged.path / name)
        same = _same_rows(before, after)
        rows[start : start + len(same)] = same
        start += len(same)
    if any(name not in pose_files(reference.base) for name in files):
        rows[:] = False
    stamps, counts = np.unique(
        open_recording(damaged.recording, damaged.reader).track().timestamp_ns, return_counts=True
    )
    return set(stamps[counts == 1].tolist()) & set(reference.stamps_ns[rows].tolist())


def pose_files(base: Base) -> list[str]:
    """The files with one pose per row, in order."""
    names = {
        "folder": ["poses.csv"],
        "csv": ["track.csv"],
        "boreas": ["camera_poses.csv"],
        "dgp": [],
        "mcap": [],
        "rosbag2": [],
        "nuscenes": [],
        "argoverse2": [],
        "colmap": [],
        "nuplan": [],
        "waymo": [],
        "kitti360": [],
        "kitti_odometry": [],
        "kitti_raw": [],
        "video_gps": [],
        "ncore": [],
        "comma2k19": [f"{number}/global_pose/frame_positions" for number in range(2)],
    }
    return names[base.reader]


def _bytes(file: Path) -> bytes:
    return file.read_bytes() if file.is_file() else b""


def _same_rows(before: bytes, after: bytes) -> np.ndarray:
    """(N,) True where a row of a table is unchanged."""
    if before.startswith(b"\x93NUMPY"):
        array = np.load(io.BytesIO(before))
        try:
            other = np.load(io.BytesIO(after))
        except Exception:  # noqa: BLE001
            other = array[:0]
        if other.shape != array.shape or other.dtype != array.dtype:
            return np.zeros(len(array), np.bool_)
        return np.asarray((array == other).all(axis=1))
    lines, others = before.split(b"\n")[:-1], after.split(b"\n")[:-1]
    if lines[0] != others[0] if others else True:
        return np.zeros(len(lines) - 1, np.bool_)
    present = set(others[1:])
    return np.array([line in present for line in lines[1:]])
