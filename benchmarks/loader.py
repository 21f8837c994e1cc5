"""Measures what loading images out of a bucket costs: requests, bytes, and images a second with a delay a request.

``python -m benchmarks loader [--frames N] [--delay-ms MS]`` makes a dataset of two drives with seven cameras, as shards
and as a file an image, serves it by a server of S3 on this machine, and reads it: frame by frame, in shuffled batches,
by several workers' shares, and one image after the other as a plain program does.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

import mirror
from mirror.dataset.dataset import Dataset
from mirror.dataset.images.shards import pack_images
from mirror.dataset.index import build_index
from mirror.dataset.layout import manifest_sha256, seal
from mirror.dataset.torch import IterableFrames, epoch_order
from mirror.errors import ExitCode
from mirror.schema.documents import ImageTotals
from mirror.schema.files import encode_table, read_table, write_bytes
from mirror.schema.tables import IMAGES
from tests.builders.bucket import BUCKET, ENVIRONMENT, Bucket, serving
from tests.builders.dataset import EPOCH, SECOND, SEVEN, Builder, Pass

SIZE = (320, 240)
BATCH = 8
LONGEST_S = 20.0


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="benchmarks loader", description=__doc__)
    parser.add_argument("--frames", type=int, default=60, help="of each of two drives, with seven images each")
    parser.add_argument("--delay-ms", type=float, default=30.0, help="that each request takes longer")
    arguments = parser.parse_args(argv)
    bucket = Bucket()
    with tempfile.TemporaryDirectory() as folder:
        for name in ("shards", "files"):
            make_dataset(Path(folder) / name, arguments.frames, shards=name == "shards")
            for path in Path(folder).rglob("*"):
                if path.is_file():
                    bucket.objects[path.relative_to(folder).as_posix()] = path.read_bytes()
    with serving(bucket), reached(bucket):
        print(f"{'':44} {'requests':>9} {'bytes':>7} {'images':>9} {'with ' + str(arguments.delay_ms) + ' ms':>12}")
        print(f"{'':44} {'an image':>9} {'/ own':>7} {'a second':>9} {'a request':>12}")
        for name, read in READS.items():
            place = f"s3://{BUCKET}/{'files' if 'file' in name else 'shards'}"
            print(f"{name:44} {measure(bucket, place, read, arguments.delay_ms / 1e3)}")
    return ExitCode.DONE


@contextmanager
def reached(bucket: Bucket) -> Iterator[None]:
    """Let the toolkit find the server."""
    before = dict(os.environ)
    os.environ.update({**ENVIRONMENT, "AWS_ENDPOINT_URL": bucket.endpoint})
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def make_dataset(root: Path, frames: int, *, shards: bool) -> None:
    """Make a dataset of two drives with seven cameras, whose images differ.

    Args:
        root: a new folder.
        frames: of each drive.
        shards: put the images into shards.
    """
    builder = Builder(root, cameras=SEVEN, size=SIZE)
    builder.scene("a")
    generator = np.random.default_rng(7)
    noise = {camera: generator.integers(0, 256, (SIZE[1] // 2, SIZE[0] // 2, 3), np.uint8) for camera in SEVEN}
    encoded = {
        camera: cv2.imencode(".jpg", cv2.resize(image, SIZE), [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
        for camera, image in noise.items()
    }
    for number in range(2):
        drive = f"d{number}"
        one = Pass("a", EPOCH + number * 10**5 * SECOND, frames=frames, images=encoded)
        (traversal,) = builder.drive(drive, [one])
        if shards:
            _pack(builder, drive, traversal)
    build_index(root)


def _pack(builder: Builder, drive_id: str, traversal_id: str) -> None:
    """Move the images of a traversal into shards, and seal it and its drive again."""
    folder, layout = builder.layout.recorded(traversal_id), builder.layout
    images = pack_images(
        read_table(folder / "images.parquet", IMAGES), builder.root, f"traversals/{traversal_id}/recorded"
    )
    write_bytes(folder / "images.parquet", encode_table(images, IMAGES))
    total = sum(images.column("byte_length").to_pylist())
    names = ("ego_poses", "images", "calibrations")
    files = {f"{name}.parquet": (folder / f"{name}.parquet").read_bytes() for name in names}
    seal(folder, files, derived_from={}, images=ImageTotals(count=images.num_rows, bytes=total))
    drive = layout.drive(drive_id)
    own = {name: (drive / name).read_bytes() for name in ("passes.parquet", "drive.json")}
    seal(drive, own, derived_from={f"traversal:{traversal_id}": manifest_sha256(folder)})


def read_frames(dataset: Dataset) -> Iterator[bytes]:
    """Read the encoded images of all frames in order."""
    for frame in dataset.frames():
        yield from (image.read() for image in frame.images.values())


def read_shuffled(dataset: Dataset) -> Iterator[bytes]:
    """Read the encoded images of shuffled batches, as `IterableFrames` does."""
    frames = dataset.frames()
    order = epoch_order(len(frames), 0, 0).tolist()
    for batch in frames.read_ahead(order[start : start + BATCH] for start in range(0, len(order), BATCH)):
        for frame in batch:
            yield from (image.read() for image in frame.images.values())


def read_batches(dataset: Dataset) -> Iterator[bytes]:
    """Decode shuffled batches to tensors."""
    for batch in IterableFrames(dataset, BATCH, boxes=False):
        yield from (b"" for _ in range(int(batch["valid"].sum())))


def read_one_by_one(dataset: Dataset) -> Iterator[bytes]:
    """Read one image after the other, as a program without this loader does."""
    frames = dataset.frames()
    for index in range(len(frames)):
        yield from (image.read() for image in frames[index].images.values())


READS: dict[str, Callable[[Dataset], Iterator[bytes]]] = {
    "shards, frame order": read_frames,
    "shards, shuffled": read_shuffled,
    "shards, shuffled, decoded to tensors": read_batches,
    "a file an image, frame order, read ahead": read_frames,
    "a file an image, one after the other": read_one_by_one,
}


def measure(bucket: Bucket, place: str, read: Callable[[Dataset], Iterator[bytes]], delay_s: float) -> str:
    """Return the figures of one way to read, as a row of the table."""
    rates = []
    for wait_s in (0.0, delay_s):
        bucket.delay_s = 0.0
        dataset = mirror.open(place)
        own = sum(dataset.table("images", ["byte_length"]).column(0).to_pylist())
        dataset = mirror.open(place)
        bucket.requests.clear()
        bucket.delay_s = wait_s
        start = time.perf_counter()
        count = 0
        for _ in read(dataset):
            count += 1
            if wait_s and time.perf_counter() - start > LONGEST_S:
                break
        rates.append(count / (time.perf_counter() - start))
        if not wait_s:
            requests, sent = bucket.count() / count, sum(request.sent for request in bucket.requests) / own
    return f"{requests:9.3f} {sent:7.3f} {rates[0]:9.0f} {rates[1]:12.0f}"
