"""A small recording in the `folder` layout, which the tests change."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.builders.folder import folder_document

START_NS = 1_628_184_886_000_000_000
ROWS = [(START_NS + index * 100_000_000, 13.4 + index * 1e-5, 52.5, 40.0) for index in range(5)]
POSES = "timestamp_ns,longitude_deg,latitude_deg,height_m\n" + "".join(",".join(map(str, row)) + "\n" for row in ROWS)
CALIBRATION = {
    "camera": "front_wide",
    "model": "pinhole",
    "width_px": 8,
    "height_px": 6,
    "fx_px": 5.0,
    "fy_px": 5.0,
    "cx_px": 4.0,
    "cy_px": 3.0,
    "ego_SE3_camera": [0.5, -0.5, 0.5, -0.5, 1.5, 0.0, 1.4],
}


def document(**changes: Any) -> dict[str, Any]:
    """A recording.json with one camera."""
    base = {
        "vehicle_id": "car-7",
        "rig_id": "rig-a",
        "reference_camera": "front_wide",
        "cameras": {"front_wide": {"source_name": "cam0"}},
    }
    merged = folder_document(**{"drive_id": "drive-1", **base, **changes})
    return {key: value for key, value in merged.items() if value is not ...}


POSES_ONLY: Mapping[str, Any] = {"cameras": ..., "rig_id": ..., "reference_camera": ...}


def write_recording(
    root: Path, *, poses: str | None = POSES, images: Sequence[str] | None = None, **changes: Any
) -> Path:
    """Write the recording and return its folder."""
    root.mkdir(parents=True, exist_ok=True)
    (root / "recording.json").write_text(json.dumps(document(**changes)))
    if poses is not None:
        (root / "poses.csv").write_text(poses)
    folder = root / "images" / "front_wide"
    folder.mkdir(parents=True)
    for name in images if images is not None else [f"{row[0]}.jpg" for row in ROWS]:
        write_image(folder / name)
    return root


def write_image(file: Path) -> None:
    """A tiny image."""
    file.parent.mkdir(parents=True, exist_ok=True)
    done, data = cv2.imencode(file.suffix, np.zeros((6, 8, 3), np.uint8))
    assert done
    file.write_bytes(data.tobytes())
