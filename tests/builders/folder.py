"""Small `folder` recordings on a straight street, with real JPEGs, for the tests of ingest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyproj

from mirror.dataset.index import build_index
from mirror.schema.documents import Roi

LON, LAT = 11.5755, 48.1374
START_NS = 1_700_000_000_000_000_000
SCENE = Roi(scene_id="street", longitude_deg=LON, latitude_deg=LAT, radius_m=60.0)
CAMERAS = ("front_wide", "rear")
_GEOD = pyproj.Geod(ellps="WGS84")


def folder_document(drive_id: str, **more: Any) -> dict[str, Any]:
    """Return the recording.json of a drive in Unix nanoseconds and, unless ``more`` states another, WGS 84.

    Args:
        drive_id: the drive.
        more: other fields of the document, or other values.
    """
    return {
        "format": "mirror-folder",
        "version": "1.0",
        "drive_id": drive_id,
        "vehicle_id": "car",
        "vehicle_type": "van",
        "time_base": "unix_ns",
        "frame": {"kind": "wgs84"},
        **more,
    }


def locate_on_street(offset_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return longitude and latitude east of the scene's centre by so many metres."""
    ones = np.ones_like(offset_m)
    lon, lat, _ = _GEOD.fwd(LON * ones, LAT * ones, 90.0 * ones, offset_m)
    return lon, lat


def write_recording(
    root: Path,
    drive_id: str,
    *,
    start_ns: int = START_NS,
    from_m: float = -120.0,
    to_m: float = 120.0,
    speed_mps: float = 8.0,
    cameras: tuple[str, ...] = CAMERAS,
    parts: int = 1,
    seed: int = 0,
) -> Path:
    """One drive along the street; images at 4 Hz, poses at 10 Hz, both with exposure in the middle of the stamp."""
    folder = root / drive_id
    (folder / "calibrations").mkdir(parents=True)
    seconds = np.arange(0.0, abs(to_m - from_m) / speed_mps + 1e-9, 0.1)
    stamps = start_ns + np.round(seconds * 1e9).astype(np.int64)
    lon, lat = locate_on_street(from_m + np.sign(to_m - from_m) * speed_mps * seconds)
    rows = [f"{t},{x:.12f},{y:.12f},520.0,{90.0 if to_m > from_m else 270.0}" for t, x, y in zip(stamps, lon, lat)]
    header = "timestamp_ns,longitude_deg,latitude_deg,height_m,heading_deg\n"
    if parts == 1:
        (folder / "poses.csv").write_text(header + "\n".join(rows) + "\n")
    else:
        (folder / "poses").mkdir()
        for number, part in enumerate(np.array_split(np.arange(len(rows)), parts)):
            text = header + "\n".join(rows[index] for index in part) + "\n"
            (folder / "poses" / f"part_{number + 1}.csv").write_text(text)
    document = folder_document(
        drive_id,
        vehicle_id=f"car_{seed % 3}",
        vehicle_type="sedan",
        rig_id="two" if cameras else None,
        weather="clear",
        reference_camera=cameras[0] if cameras else None,
        cameras={camera: {} for camera in cameras},
    )
    (folder / "recording.json").write_text(json.dumps(document))
    calibration = [
        {
            "camera": camera,
            "model": "pinhole",
            "width_px": 64,
            "height_px": 48,
            "fx_px": 50.0,
            "fy_px": 50.0,
            "cx_px": 32.0,
            "cy_px": 24.0,
            "distortion": [],
            "ego_SE3_camera": [0.5, -0.5, 0.5, -0.5, 1.5, 0.0, 1.6],
            "valid_from_ns": None,
            "valid_to_ns": None,
            "time_offset_ns": 0,
            "shutter_direction": "global",
            "readout_ns": 0,
            "covariance": None,
            "method": None,
        }
        for camera in cameras
    ]
    (folder / "calibrations" / "factory.json").write_text(json.dumps(calibration))
    generator = np.random.default_rng(seed)
    for number, camera in enumerate(cameras):
        (folder / "images" / camera).mkdir(parents=True)
        for stamp in stamps[::3] + number * 7_000_000:
            if stamp > stamps[-1]:
                continue
            image = cv2.resize(generator.integers(0, 255, (6, 8, 3), dtype=np.uint8), (64, 48))
            (folder / "images" / camera / f"{stamp}.jpg").write_bytes(cv2.imencode(".jpg", image)[1].tobytes())
    return folder


def tree(root: Path, *, but: tuple[str, ...] = (".lock",)) -> dict[str, str]:
    """Hash of every file under a folder, by relative path.

    Of an index, the files that its newest snapshot names: the others, and the snapshots, tell its history.
    """
    past = {file for index in root.rglob("index/snapshots") for file in _past_files(index.parent)}
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name not in but and path not in past
    }


def compact_tree(root: Path) -> dict[str, str]:
    """Hash of every file of a dataset, by relative path, with its index made compact."""
    build_index(root, compact=True)
    return tree(root)


def _past_files(index: Path) -> Iterator[Path]:
    """The snapshots of an index, and the files that its newest one does not name."""
    newest = max(index.glob("snapshots/*.json"), default=None)
    named = [] if newest is None else [one["name"] for one in json.loads(newest.read_text())["segments"]]
    for path in index.rglob("*"):
        if path.relative_to(index).parts[0] not in named:
            yield path
