"""Measures reading of nuScenes tables: processor time and memory at a tenth of trainval, against nuscenes-devkit.

``python -m benchmarks nuscenes_tables [--scenes N] [--keep FOLDER]`` writes tables of N scenes (85: 267,000 rows of
``sample_data``, 116,000 boxes) without images. A process reads one scene with poses, calibrations, stamps and boxes,
then a second one, which shares the tables. The devkit reads the same folder in the environment that ``make peers``
built; without it the row has no peer. The error is the largest distance between written and read positions in metres.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from hashlib import md5
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.report import Peer, Row, report

DEVKIT = Path(__file__).parents[1] / "build" / "peers" / "nuscenes" / "env" / "bin" / "python"
_CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
_RADARS = ("RADAR_FRONT", "RADAR_FRONT_LEFT", "RADAR_FRONT_RIGHT", "RADAR_BACK_LEFT", "RADAR_BACK_RIGHT")
_RATES = {**dict.fromkeys(_CAMERAS, 12), "LIDAR_TOP": 20, **dict.fromkeys(_RADARS, 13)}
_SAMPLES, _INSTANCES, _START_US = 40, 34, 1_532_402_927_000_000
_OURS = """
import json, sys, time
from pathlib import Path
from mirror.recordings.registry import list_drives, open_recording
def read(path):
    recording = open_recording(path)
    track = recording.track()
    recording.calibrations(), recording.images(), recording.boxes()
    return track
drives = list_drives(Path(sys.argv[1]))
track = read(drives[0])
first = time.process_time()
read(drives[1])
out = {"s": first, "next_s": time.process_time() - first, "x_m": [float(track.x_m[0]), float(track.x_m[-1])]}
mb = int(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]) / 1e3
print(json.dumps({**out, "mb": mb}))
"""
_THEIRS = """
import json, sys, time
from nuscenes.nuscenes import NuScenes
NuScenes("v1.0-trainval", sys.argv[1], verbose=False)
mb = int(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]) / 1e3
print(json.dumps({"s": time.process_time(), "mb": mb}))
"""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks nuscenes_tables", description=__doc__)
    parser.add_argument("--scenes", type=int, default=85)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--keep", type=Path, default=None, help="folder of the tables; default: a temporary one")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as temporary:
        root = arguments.keep or Path(temporary)
        last_m = write_tables(root, arguments.scenes)
        ours = [_child(sys.executable, _OURS, root) for _ in range(arguments.repeats)]
        theirs = [_child(str(DEVKIT), _THEIRS, root) for _ in range(arguments.repeats if DEVKIT.exists() else 0)]
        size = f"{sum(file.stat().st_size for file in (root / 'v1.0-trainval').iterdir()) / 1e6:.0f} MB of JSON"
    error = max(abs(ours[0]["x_m"][0]), abs(ours[0]["x_m"][1] - last_m))
    peer = "nuscenes-devkit, constructor"
    peers = {
        key: (Peer(peer, scale * _median(theirs, key)),) if theirs else () for key, scale in (("s", 1e3), ("mb", 1))
    }
    rows = [
        Row(
            "all tables and one scene, processor ms", size, 1e3 * _median(ours, "s"), error, peers["s"], "m", None, 1e-6
        ),
        Row("largest memory, MB", size, _median(ours, "mb"), None, peers["mb"]),
        Row("another scene, processor ms", size, 1e3 * _median(ours, "next_s")),
    ]
    return report("nuscenes_tables", {"tables of nuScenes": rows})


def _median(found: Sequence[dict[str, Any]], key: str) -> float:
    return float(np.median([one[key] for one in found]))


def _child(python: str, code: str, root: Path) -> dict[str, Any]:
    done = subprocess.run([python, "-c", code, str(root)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def token(*words: object) -> str:
    """Return a token of 32 hexadecimal digits."""
    return md5(" ".join(map(str, words)).encode()).hexdigest()


def write_tables(root: Path, scenes: int) -> float:
    """Write the tables of straight drives at 8 m/s, and return the last x of each scene in metres."""
    folder = root / "v1.0-trainval"
    folder.mkdir(parents=True, exist_ok=True)
    (root / "maps").mkdir(exist_ok=True)
    (root / "maps" / "a.png").write_bytes(cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1].tobytes())
    sensors = [
        {"token": token(name), "channel": name, "modality": "camera" if name in _CAMERAS else name[:5].lower()}
        for name in _RATES
    ]
    log = {"token": token("log"), "logfile": "n1", "vehicle": "n1", "date_captured": "2018-07-24", "location": "town"}
    write = {
        "sensor": sensors,
        "log": [log],
        "map": [{"token": "m", "log_tokens": [log["token"]], "category": "", "filename": "maps/a.png"}],
        "category": [{"token": token("car"), "name": "vehicle.car", "description": ""}],
        "attribute": [{"token": token("moving"), "name": "vehicle.moving", "description": ""}],
        "visibility": [{"token": "4", "level": "v80-100", "description": ""}],
        "calibrated_sensor": [_calibrated(sensor) for sensor in sensors],
        "scene": [_scene(number, log["token"]) for number in range(scenes)],
        "sample": [row for number in range(scenes) for row in _samples(number)],
        "sample_data": [row for number in range(scenes) for row, _ in _data(number)],
        "ego_pose": [row for number in range(scenes) for _, row in _data(number)],
        "instance": [_instance(number, one) for number in range(scenes) for one in range(_INSTANCES)],
        "sample_annotation": [row for number in range(scenes) for row in _annotations(number)],
    }
    for name, rows in write.items():
        (folder / f"{name}.json").write_text(json.dumps(rows, indent=0))
    return max(float(pose["translation"][0]) for _, pose in _data(0))


def _calibrated(sensor: dict[str, Any]) -> dict[str, Any]:
    matrix = [[1266.0, 0.0, 816.0], [0.0, 1266.0, 491.0], [0.0, 0.0, 1.0]] if sensor["modality"] == "camera" else []
    return {
        "token": token("calibrated", sensor["channel"]), "sensor_token": sensor["token"],
        "translation": [1.7, 0.0, 1.5], "rotation": [0.5, -0.5, 0.5, -0.5], "camera_intrinsic": matrix,
    }  # fmt: skip


def _scene(number: int, log: str) -> dict[str, Any]:
    return {
        "token": token("scene", number), "log_token": log, "nbr_samples": _SAMPLES, "name": f"scene-{number:04d}",
        "first_sample_token": token("sample", number, 0), "last_sample_token": token("sample", number, _SAMPLES - 1),
        "description": "Parked cars",
    }  # fmt: skip


def _links(words: Sequence[object], row: int, count: int) -> dict[str, str]:
    return {
        "prev": token(*words, row - 1) if row else "",
        "next": token(*words, row + 1) if row + 1 < count else "",
    }


def _samples(number: int) -> Iterator[dict[str, Any]]:
    for row in range(_SAMPLES):
        stamp = _START_US + number * 40_000_000 + row * 500_000
        yield {
            "token": token("sample", number, row), "timestamp": stamp, "scene_token": token("scene", number),
            **_links(("sample", number), row, _SAMPLES),
        }  # fmt: skip


def _data(number: int) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Rows of ``sample_data``, each with its ego pose."""
    for channel, rate in _RATES.items():
        for row in range(20 * rate):
            after_us = row * 1_000_000 // rate
            stamp, mine, key = _START_US + number * 40_000_000 + after_us, token(number, channel, row), row % 6 == 0
            image = channel in _CAMERAS
            name = f"n1-2018-07-24-11-22-45+0800__{channel}__{stamp}.{'jpg' if image else 'pcd.bin'}"
            data = {
                "token": mine, "sample_token": token("sample", number, after_us // 500_000), "ego_pose_token": mine,
                "calibrated_sensor_token": token("calibrated", channel), "timestamp": stamp, "is_key_frame": key,
                "fileformat": "jpg" if image else "pcd", "height": 900 * image, "width": 1600 * image,
                "filename": f"{'samples' if key else 'sweeps'}/{channel}/{name}",
                **_links((number, channel), row, 20 * rate),
            }  # fmt: skip
            place = [round(8e-6 * after_us, 9), 0.0, 0.0]
            yield data, {"token": mine, "timestamp": stamp, "rotation": [1.0, 0.0, 0.0, 0.0], "translation": place}


def _instance(number: int, one: int) -> dict[str, Any]:
    return {
        "token": token("instance", number, one), "category_token": token("car"), "nbr_annotations": _SAMPLES,
        "first_annotation_token": token("box", number, one, 0),
        "last_annotation_token": token("box", number, one, _SAMPLES - 1),
    }  # fmt: skip


def _annotations(number: int) -> Iterator[dict[str, Any]]:
    for one in range(_INSTANCES):
        for row in range(_SAMPLES):
            yield {
                "token": token("box", number, one, row), "sample_token": token("sample", number, row),
                "instance_token": token("instance", number, one), "visibility_token": "4",
                "attribute_tokens": [token("moving")], "translation": [373.256 + one, 1130.419, 0.8],
                "size": [1.9, 4.5, 1.6], "rotation": [0.983, 0.0, 0.0, -0.182], "num_lidar_pts": 1,
                "num_radar_pts": 0, **_links(("box", number, one), row, _SAMPLES),
            }  # fmt: skip
