"""A dataset whose images differ from each other, with redaction layers, for tests of what leaves it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa

import mirror
from mirror.dataset.dataset import Dataset
from mirror.dataset.index.build import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.dataset.splits import make_split
from mirror.dataset.store import Store
from mirror.export.publish import PublishOptions, PublishReport, publish
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import read_rois
from mirror.ingest.run import ingest_recordings
from mirror.protocols.document import Protocol
from mirror.schema.bundle import Bundle
from mirror.schema.documents import NovelTraversal
from mirror.schema.files import read_table, write_json
from mirror.schema.tables import IMAGES
from tests.evaluation.submissions import SPLIT, small

CAMERAS = ("front_wide", "front_left", "rear")


def write_three_cameras(recordings: Sequence[Path], folder: Path) -> Dataset:
    """Write the dataset of two recordings in the folder layout as if there were three cameras, with a split."""
    for recording in recordings:
        copy = shutil.copytree(recording, folder / recording.name, copy_function=os.link)
        document = json.loads((recording / "recording.json").read_bytes())
        document["cameras"] = {name: document["cameras"][name] for name in CAMERAS}
        write_json(copy / "recording.json", document)
        for file in (copy / "calibrations").iterdir():
            rows = [row for row in json.loads(file.read_bytes()) if row["camera"] in CAMERAS]
            write_json(file, rows)
    rois = read_rois(recordings[0].parent / "rois.geojson")
    copies = [folder / recording.name for recording in recordings]
    report = ingest_recordings(copies, rois, folder / "dataset", IngestOptions())
    assert not report.failures, report.failures
    make_split(folder / "dataset", SPLIT, NovelTraversal(train=1, held_out=1))
    return mirror.open(folder / "dataset")


def copied(dataset: Dataset, root: Path) -> Path:
    """A copy of a dataset; its images are links."""

    def copy(source: str, target: str) -> None:
        if source.endswith(".jpg"):
            os.link(source, target)
        else:
            shutil.copyfile(source, target)

    return Path(shutil.copytree(dataset.root, root, copy_function=copy, ignore=shutil.ignore_patterns(".lock")))


def redact(
    root: Path,
    traversals: Sequence[str] | None = None,
    *,
    version: str = "1",
    without: frozenset[int] = frozenset(),
    shards: bool = False,
) -> None:
    """Write a redaction layer: a black corner in every image but those of some times."""
    layout, store = Layout(root), Store(root)
    for traversal_id in traversals or sorted(path.name for path in (root / "traversals").iterdir()):
        writer = LayerWriter(layout, traversal_id, "redaction", "corner", version)
        rows = []
        for row in read_table(layout.recorded(traversal_id) / "images.parquet", IMAGES).to_pylist():
            if row["timestamp_ns"] in without:
                continue
            recorded = store.read_range(row["uri"], row["byte_offset"], row["byte_length"])
            pixels = cv2.imdecode(np.frombuffer(recorded, np.uint8), cv2.IMREAD_COLOR)
            pixels[: 8 + 4 * int(version), :16] = 0
            data = cv2.imencode(".jpg", pixels)[1].tobytes()
            file = writer.file(f"{row['camera']}/{row['timestamp_ns']}.jpg", data)
            rows.append({**row, **file, "byte_offset": 0, "codec": "jpeg", "privacy": "redacted"})
        table = pa.Table.from_pylist(rows, schema=IMAGES.schema)
        writer.finish(IMAGES, writer.pack(table) if shards else table, {})
    build_index(root)


def recorded_images(root: Path) -> dict[Path, bytes]:
    """Bytes of the recorded images."""
    return {path: path.read_bytes() for path in sorted(root.glob("traversals/*/recorded/*/*.jpg"))}


def publish_to(root: Path, out: Path | str, *protocols: Protocol) -> PublishReport:
    """Publish a dataset."""
    options = PublishOptions(split=SPLIT, protocols=protocols or (small(),), name="Street", licence="CC0-1.0")
    return publish(root, str(out), options)


def sealed(report: PublishReport) -> Bundle:
    """The document of a bundle that was sealed."""
    assert report.bundle is not None, report.leaks
    return report.bundle
