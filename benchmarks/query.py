"""Measures time, exactness and memory of opening, querying and decoding, against pandas.

``python -m benchmarks query [--rows N ...] [--keep FOLDER]`` generates an index (10 scenes, 7 cameras, 400 frames in a
traversal; no images), and one traversal of real JPEGs. Rows: ``name, size, ms, error, peer``; the error of a query is
the number of rows that differ from brute force over all rows with PROJ's exact geodesic.

The peers: pandas, which reads the same Parquet files and filters them; and py123d 0.7.0, with figures quoted from a
similar machine (280 k image rows, 200 m radius by one callback for each scene: 4.8 s; a seven-camera 960 x 540 set from
JPEG: 35 to 39 ms).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import mirror
from benchmarks.report import Peer, Row, median_ms, report
from mirror.arrays import UInt8
from mirror.dataset import Dataset
from mirror.dataset.index import build_index
from tests.builders.dataset import EPOCH, SECOND, SEVEN, Builder, Pass

SCENES = 10
FRAMES = 400
KEYS = ("scene_id", "traversal_id", "camera", "timestamp_ns", "uri")
CAMERA_SIZE = (960, 540)

# Measured in a new process, so that imports and the memory of the generator do not count.
_CHILD = """
import json, sys, time
import numpy as np
import mirror.dataset.dataset
def rss():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 2**20
root, centres, keys = json.loads(sys.argv[1])
imported = rss()
start = time.perf_counter(); dataset = mirror.open(root); opened = time.perf_counter() - start
idle = rss()
lon, lat = centres[0]
start = time.perf_counter(); dataset.where(within=(lon, lat, 1000.0)).table("images", keys)
first = time.perf_counter() - start
rng = np.random.default_rng(0)
memory = []
for number in range(200):
    lon, lat = centres[rng.integers(len(centres))]
    dataset.where(within=(lon + rng.uniform(-1e-3, 1e-3), lat, rng.uniform(20, 400))).table("images", keys)
    memory.append(rss())
print(json.dumps({"imported": imported, "open_ms": opened * 1e3, "idle": idle, "first_ms": first * 1e3,
                  "after_100": max(memory[:100]), "after_200": max(memory[100:]),
                  "cache": dataset.catalog.columns.held_bytes / 2**20}))
"""


def scene_centre(scene: int) -> tuple[float, float]:
    """Return the longitude and latitude of a generated scene."""
    return -79.4 + 0.02 * scene, 43.6 + 0.01 * (scene % 3)


def generate(root: Path, rows: int) -> Path:
    """Generate a dataset with about this number of image rows, without images, and its index."""
    builder = Builder(root, cameras=SEVEN, size=CAMERA_SIZE)
    for scene in range(SCENES):
        builder.scene(f"s{scene}", *scene_centre(scene))
    rng = np.random.default_rng(0)
    for number in range(round(rows / (FRAMES * len(SEVEN)))):
        one = Pass(
            f"s{number % SCENES}",
            EPOCH + number * 1000 * SECOND,
            frames=FRAMES,
            heading_deg=float(rng.uniform(0, 360)),
            offset_m=float(rng.uniform(-100, 100)),
            light=("day", "dusk", "night")[number % 3],
        )
        builder.drive(f"d{number}", [one])
    build_index(root)
    return root


def make_image(seed: int) -> UInt8:
    """Return an image with smooth parts, edges and noise, which compresses like a photograph."""
    import cv2

    rng = np.random.default_rng(seed)
    width, height = CAMERA_SIZE
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(x / (20 + seed) + y / 37), np.cos(y / 23 + x / 51), np.sin((x + y) / 29)]
    pixels = 128 + 80 * np.stack(waves, axis=-1) + rng.normal(0, 6, (height, width, 3))
    for left, top in zip(rng.integers(0, width - 40, 60).tolist(), rng.integers(0, height - 30, 60).tolist()):
        cv2.rectangle(pixels, (left, top), (left + 40, top + 30), rng.integers(0, 255, 3).tolist(), -1)
    return np.clip(pixels, 0, 255).astype(np.uint8)


def brute_force(dataset: Dataset, within: tuple[float, float, float]) -> tuple[set[tuple[object, ...]], float]:
    """Return the keys of all rows within a circle, by pandas over all rows and PROJ; and the time this took."""
    import pandas as pd
    import pyproj

    start = time.perf_counter()
    files = sorted(dataset.layout.index.glob("*/images/*.parquet"))
    rows = pd.concat([pd.read_parquet(file, columns=[*KEYS, "longitude_deg", "latitude_deg"]) for file in files])
    count = len(rows)
    _, _, distance = pyproj.Geod(ellps="WGS84").inv(
        rows["longitude_deg"], rows["latitude_deg"], np.full(count, within[0]), np.full(count, within[1])
    )
    inside = rows[np.asarray(distance) <= within[2]]
    elapsed = (time.perf_counter() - start) * 1e3
    return set(zip(inside["traversal_id"], inside["camera"], inside["timestamp_ns"])), elapsed


def query_rows(root: Path) -> Iterator[Row]:
    """Yield the rows of queries on one generated dataset."""
    task = json.dumps([str(root), [scene_centre(scene) for scene in range(SCENES)], KEYS])
    done = subprocess.run([sys.executable, "-c", _CHILD, task], capture_output=True, text=True, check=True)
    child = json.loads(done.stdout)
    dataset = mirror.open(root)
    total = dataset.count("images")
    size = f"{total:,} rows"
    grown = child["idle"] - child["imported"]
    yield Row("open", size, child["open_ms"], peers=(Peer("nuScenes devkit, quoted, 263 k rows:", 4600.0),), bar=300.0)
    yield Row("first ROI query", size, child["first_ms"], bar=400.0)
    yield Row("idle memory, MiB RSS", size, child["idle"], grown, unit="MiB above imports", bar=120.0)
    grown = child["after_200"] - child["after_100"]
    yield Row("memory after 200 queries, MiB RSS", size, child["after_200"], grown, unit="MiB in the last 100")
    for name, radius in (("ROI query, a whole scene", 1000.0), ("ROI query, a part of a scene", 150.0)):
        within = (*scene_centre(3), radius)

        def run(within: tuple[float, float, float] = within) -> object:
            return dataset.where(within=within).table("images", KEYS)

        ms = median_ms(run, 15)
        expected, brute_ms = brute_force(dataset, within)
        keys = dataset.where(within=within).table("images", ("traversal_id", "camera", "timestamp_ns")).to_pydict()
        mismatches = len(expected ^ set(zip(*keys.values())))
        peers: tuple[Peer, ...] = (Peer("pandas", brute_ms, 0.0),)
        if total < 500_000:
            peers += (Peer("py123d, quoted:", 4800.0),)
        bar = 20.0 if total < 500_000 else 40.0
        yield Row(f"{name}: {len(expected) / total:.0%} of rows", size, ms, mismatches, peers, "rows", bar)


def decode_row(folder: Path) -> Row:
    """Return the time from the files of a random seven-camera set to one contiguous array."""
    import cv2

    pixels = {camera: make_image(number) for number, camera in enumerate(SEVEN)}
    jpegs = {
        camera: cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
        for camera, pixels in pixels.items()
    }
    builder = Builder(folder, cameras=SEVEN, size=CAMERA_SIZE)
    builder.scene("s")
    builder.drive("d", [Pass("s", frames=40, images=jpegs)])
    build_index(folder)
    frames = mirror.open(folder).frames()
    rng = np.random.default_rng(0)
    ms = median_ms(lambda: frames[int(rng.integers(len(frames)))].decode(), 60)

    def one_by_one() -> UInt8:
        images = frames[int(rng.integers(len(frames)))].images.values()
        read = [np.asarray(cv2.imdecode(np.frombuffer(image.read(), np.uint8), cv2.IMREAD_COLOR)) for image in images]
        return np.ascontiguousarray(np.stack([pixels[..., ::-1].transpose(2, 0, 1) for pixels in read]), np.uint8)

    peers = (Peer("cv2", median_ms(one_by_one, 20), 0.0), Peer("py123d, quoted:", 35.0))
    differing = int(np.count_nonzero(frames[0].decode() != one_by_one()))
    kilobytes = sum(map(len, jpegs.values())) // 1000
    return Row("seven cameras to CHW", f"960x540, {kilobytes} kB", ms, differing, peers, "values", 18.0)


def main(argv: Sequence[str]) -> int:
    """Run the benchmark and print its rows."""
    parser = argparse.ArgumentParser(prog="benchmarks query", description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rows", type=int, nargs="+", default=[280_000, 1_000_000], help="image rows of each dataset")
    parser.add_argument("--keep", type=Path, help="generate datasets here, and use existing ones")
    options = parser.parse_args(argv)

    def rows(folder: Path) -> Iterator[Row]:
        for count in options.rows:
            root = (options.keep or folder) / f"rows-{count}"
            if not (root / "index" / "snapshots").is_dir():
                generate(root, count)
            yield from query_rows(root)
        yield decode_row(folder / "images")

    with tempfile.TemporaryDirectory() as temporary:
        return report("query", {"query": rows(Path(temporary))}, errors="rows or values that differ")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
