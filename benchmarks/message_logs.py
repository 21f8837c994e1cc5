"""Measures reading of message logs: memory and time at 2 GB of MCAP, against the mcap package's own reader.

``python -m benchmarks message_logs [--gigabytes N] [--keep FOLDER]`` writes a drive of ROS 2 messages (poses and JPEG
images of 400 kB at 10 Hz, chunks of 4 MiB with zstd), and reads it in processes of their own: topics; poses,
calibrations and stamps of all images; and 100 consecutive images. The error is the largest distance between
read and written positions in metres, and for images the number that differ. The bar is 400 MB of memory.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.report import Peer, Row, report
from tests.recordings.readers.message_logs.writer import TOPICS, Out, drive, messages, write_mcap

BAR_MB = 400.0
_IMAGE_BYTES = 400_000

_CHILD = """
import hashlib, json, resource, sys, time
import numpy as np
what, path = sys.argv[1:]
start = time.process_time()
out = {}
if what == "mcap":
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        out["messages"] = sum(1 for _ in reader.iter_decoded_messages(log_time_order=False))
else:
    from mirror.recordings.registry import open_recording
    recording = open_recording(path)
    if what != "topics":
        track = recording.track()
        out["x_m"] = [float(track.x_m[0]), float(track.x_m[-1])]
        out["poses"] = len(track)
        recording.calibrations()
        stream = recording.images()["front_wide"]
        out["images"] = len(stream.exposure_start_ns)
    if what == "images":
        middle = len(stream.exposure_start_ns) // 2
        start = time.process_time()
        out["sha256"] = [hashlib.sha256(data).hexdigest() for _, data in stream.read(range(middle, middle + 100))]
out["cpu_s"] = time.process_time() - start
out["mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps(out))
"""


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--keep", type=Path, help="folder for the log, which stays there")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        return report("message_logs", {"a log of a drive": _measure(folder, options.gigabytes)})


def _measure(folder: Path, gigabytes: float) -> list[Row]:
    path = folder / "drive.mcap"
    count = int(gigabytes * 1e9 / _IMAGE_BYTES)
    written = _write(path, count)
    size = f"{path.stat().st_size / 1e9:.2f} GB, {count} images"
    peer = _child("mcap", path)
    rows = []
    for what, name in (("topics", "topics"), ("stamps", "poses, lenses and stamps"), ("images", "100 images")):
        found = _child(what, path)
        error = None
        if what == "stamps":
            error = float(np.abs(np.subtract(found["x_m"], written["x_m"])).max())
        elif what == "images":
            middle = count // 2
            error = float(sum(a != b for a, b in zip(found["sha256"], written["sha256"][middle : middle + 100])))
        peers = (Peer("mcap 1.6 all messages", peer["cpu_s"] * 1e3),) if what == "stamps" else ()
        rows.append(Row(f"{name}, CPU", size, found["cpu_s"] * 1e3, error, peers=peers))
        rows.append(Row(f"{name}, peak MB", size, found["mb"], bar=BAR_MB))
    rows.append(Row("mcap 1.6, all messages, peak MB", size, peer["mb"]))
    return rows


def _write(path: Path, count: int) -> dict[str, list[Any]]:
    """Write the log; return x of the first and last pose, and the digest of every image."""
    one = drive(count * 0.1, images=1)
    poses = messages(one, position="odometry")
    fixed = [message for message in poses if message.topic in ("/tf_static", "/front/camera_info")]
    template = next(message for message in poses if message.topic == "/front/image/compressed")
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, 2**26, np.uint8).tobytes()
    starts = rng.integers(0, len(noise) - _IMAGE_BYTES, count)
    digests: list[str] = []

    def stream() -> Iterator[Out]:
        yield from fixed
        for number, pose in enumerate(message for message in poses if message.topic == "/odom"):
            yield pose
            start = int(starts[number % count])
            data = b"\xff\xd8\xff\xe0" + noise[start : start + _IMAGE_BYTES - 4]
            digests.append(hashlib.sha256(data).hexdigest())
            header = SimpleNamespace(stamp=pose.value.header.stamp, frame_id="camera_optical")
            yield replace(template, stamp=pose.stamp, value=SimpleNamespace(header=header, format="jpeg", data=data))

    write_mcap(path, stream(), chunk_bytes=4 * 2**20)
    topics = TOPICS.replace('topic = "/fix"\norientation = "/imu"', 'topic = "/odom"\nframe = "city"')
    path.with_suffix(".toml").write_text(topics)
    return {"x_m": one.frame_SE3_ego.translation[[0, -1], 0].tolist(), "sha256": digests}


def _child(what: str, path: Path) -> dict[str, Any]:
    done = subprocess.run([sys.executable, "-c", _CHILD, what, str(path)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout)
    return found
