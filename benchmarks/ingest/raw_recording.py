"""A generated recording in the `folder` layout for the copy benchmark: seven cameras, sizes of real JPEGs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from mirror.schema.documents import CANONICAL_CAMERAS, Roi

_START_NS = 1_700_000_000_000_000_000
_TYPICAL_BYTES = 225_000
_SPEED_MPS = 8.0
_PERIOD_NS = 100_000_000
_CENTRE = (8.4037, 49.0069)
_METRES_A_DEGREE = 73_100.0
# SOI, a baseline frame header of three components (1920 x 1080), and the header of their scan.
_HEADER = bytes.fromhex("ffd8 ffc0 0011 08 0438 0780 03 012200 021101 031101 ffda 000c 03 0100 0211 0311 003f00")
_END = b"\xff\xd9"


def raw_recording(folder: Path, megabytes: int, seed: int = 0) -> Roi:
    """Write a recording with all images within one accepted pass.

    Args:
        folder: folder to create.
        megabytes: size of all images, 150 to 300 kB each; smaller if they would be too few for a pass.
        seed: seed of sizes and bytes.

    Returns:
        The ROI of the pass.
    """
    rng = np.random.default_rng(seed)
    frames = max(110, round(megabytes * 1e6 / _TYPICAL_BYTES / len(CANONICAL_CAMERAS)))
    mean = megabytes * 1e6 / frames / len(CANONICAL_CAMERAS)
    half_m = 0.5 * frames * _PERIOD_NS * 1e-9 * _SPEED_MPS + 20.0
    folder.mkdir(parents=True)
    document = {
        "format": "mirror-folder",
        "version": "1.0",
        "drive_id": "drive",
        "vehicle_id": "vehicle",
        "vehicle_type": "benchmark",
        "rig_id": "seven",
        "time_base": "unix_ns",
        "frame": {"kind": "wgs84"},
        "body_frame": "ego",
        "reference_camera": CANONICAL_CAMERAS[0],
        "cameras": {camera: {"source_name": camera} for camera in CANONICAL_CAMERAS},
    }
    (folder / "recording.json").write_text(json.dumps(document))
    stamps = _START_NS + np.arange(frames + 40) * _PERIOD_NS
    lon = _CENTRE[0] + ((stamps - _START_NS) * 1e-9 * _SPEED_MPS - half_m) / _METRES_A_DEGREE
    lines = [f"{stamp},{place:.10f},{_CENTRE[1]},0.0" for stamp, place in zip(stamps.tolist(), lon.tolist())]
    (folder / "poses.csv").write_text("timestamp_ns,longitude_deg,latitude_deg,height_m\n" + "\n".join(lines) + "\n")
    noise = rng.integers(0, 255, 400_000, np.uint8).tobytes()
    for camera in CANONICAL_CAMERAS:
        images = folder / "images" / camera
        images.mkdir(parents=True)
        for stamp in stamps[20 : 20 + frames].tolist():
            size = int(rng.uniform(2 / 3, 4 / 3) * mean)
            start = int(rng.integers(0, len(noise) - size))
            (images / f"{stamp}.jpg").write_bytes(_HEADER + noise[start : start + size] + _END)
    return Roi(
        scene_id="scene", longitude_deg=_CENTRE[0], latitude_deg=_CENTRE[1], radius_m=float(min(half_m, 20_000.0))
    )
