"""Writes a drive as a log folder of the Argoverse 2 sensor dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather

from mirror.geometry.poses import COLUMNS, Poses
from tests.recordings.formats.street import StreetDrive

CAMERAS = {
    "front_wide": "ring_front_center",
    "front_left": "ring_front_left",
    "front_right": "ring_front_right",
    "rear_left": "ring_rear_left",
    "rear_right": "ring_rear_right",
    "front_narrow": "ring_side_left",
    "rear": "ring_side_right",
}


def write_argoverse2(root: Path, drive: StreetDrive, *, city: str | None = "PIT") -> Path:
    """Write a log, and return its folder. The drive's world is the city's frame."""
    path = root / drive.name
    (path / "calibration").mkdir(parents=True)
    # As in the dataset, every image and every lidar sweep has a pose at its stamp.
    stamps = np.unique(np.concatenate([drive.pose_ns, *drive.image_ns.values()]))
    _write(path / "city_SE3_egovehicle.feather", {"timestamp_ns": stamps, **_columns(drive.poses_at(stamps))})
    (path / "sensors" / "lidar").mkdir(parents=True)
    for stamp in drive.box_ns.tolist():
        _write(path / "sensors" / "lidar" / f"{stamp}.feather", {"x": [1.0]})
    names = [name for name in CAMERAS if name in drive.cameras]
    lenses = [drive.cameras[name] for name in names]
    mountings = [drive.ego_SE3_camera[name] for name in names]
    mounting = Poses(
        np.concatenate([pose.rotation for pose in mountings]), np.concatenate([pose.translation for pose in mountings])
    )
    sensors = pa.array([CAMERAS[name] for name in names])
    _write(
        path / "calibration" / "intrinsics.feather",
        {
            "sensor_name": sensors,
            "fx_px": [lens.fx_px for lens in lenses],
            "fy_px": [lens.fy_px for lens in lenses],
            "cx_px": [lens.cx_px - 0.5 for lens in lenses],
            "cy_px": [lens.cy_px - 0.5 for lens in lenses],
            "k1": [-0.24] * len(names),
            "k2": [-0.21] * len(names),
            "k3": [0.32] * len(names),
            "height_px": pa.array([lens.height_px for lens in lenses], pa.uint16()),
            "width_px": pa.array([lens.width_px for lens in lenses], pa.uint16()),
        },
    )
    # As in the dataset, a quaternion may have a negative scalar.
    _write(
        path / "calibration" / "egovehicle_SE3_sensor.feather",
        {
            "sensor_name": sensors,
            **{name: (-1 if name[0] == "q" else 1) * values for name, values in _columns(mounting).items()},
        },
    )
    for name in names:
        folder = path / "sensors" / "cameras" / CAMERAS[name]
        folder.mkdir(parents=True)
        for index, stamp in enumerate(drive.image_ns[name].tolist()):
            (folder / f"{stamp}.jpg").write_bytes(drive.image(name, index))
    _write_boxes(path / "annotations.feather", drive)
    if city is not None:
        (path / "map").mkdir()
        (path / "map" / f"log_map_archive_{drive.name}____{city}_city_12345.json").write_text("{}")
    return path


def _write_boxes(file: Path, drive: StreetDrive) -> None:
    parts = []
    ego = drive.poses_at(drive.box_ns)
    for one in drive.objects:
        count = len(drive.box_ns)
        parts.append(
            pa.table(
                {
                    "timestamp_ns": drive.box_ns,
                    "track_uuid": [one.track_id] * count,
                    "category": ["REGULAR_VEHICLE"] * count,
                    **dict(zip(("length_m", "width_m", "height_m"), np.tile(one.size_m, (count, 1)).T)),
                    **_columns(ego.inverse() @ one.world_SE3_box),
                    "num_interior_pts": [7] * count,
                }
            )
        )
    feather.write_feather(pa.concat_tables(parts), file)


def _columns(poses: Poses) -> dict[str, np.ndarray]:
    columns = poses.to_columns()
    return {name: columns[name].round(12 if name[0] == "q" else 9) for name in COLUMNS}


def _write(file: Path, columns: dict[str, object]) -> None:
    feather.write_feather(pa.table(columns), file)
