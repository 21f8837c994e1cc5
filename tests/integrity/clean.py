"""A dataset in which no rule finds anything, and the means to break it in one place."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq

from mirror.dataset.images.depth_codec import encode_depth
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import MANIFEST, Layout, manifest_sha256, read_manifest
from mirror.dataset.splits import make_split
from mirror.errors import MirrorError
from mirror.schema.documents import DatasetDocument, FileEntry, ImageTotals, Manifest, NovelTraversal, Rig
from mirror.schema.files import read_json, sha256_bytes, write_bytes, write_json
from mirror.schema.tables import BOXES, CALIBRATIONS, DEPTH, EGO_POSES, IMAGES, LIDARS, MASKS, PASSES, POINTS
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box, encode_rows

CAMERAS = ("front_wide", "front_left", "front_right")
SIZE = (48, 32)
FRAMES = 11
FRAME_NS = 1_000_000_000
TABLES = {table.name: table for table in (EGO_POSES, IMAGES, CALIBRATIONS, BOXES, MASKS, DEPTH, POINTS, LIDARS, PASSES)}
TableRows = list[dict[str, Any]]


def make_clean(root: Path) -> Path:
    """Two drives through a geodetic scene and one through a local one; layers, a refused pass and a split."""
    builder = Builder(root, cameras=CAMERAS, size=SIZE)
    builder.scene("a", city="Toronto")
    builder.scene("b", frame="yard", x_m=0.0, y_m=0.0, radius_m=150.0)
    for number, (drive, scene) in enumerate((("d0", "a"), ("d1", "a"), ("d2", "b"))):
        entry = EPOCH + number * 1000 * SECOND
        entries = (entry, entry + 100 * SECOND)[: 2 if drive == "d2" else 1]
        passes = [Pass(scene, at, FRAMES, FRAME_NS, offset_m=2.0 * number) for at in entries]
        builder.drive(drive, passes, vehicle_id=f"car{number}")
    broken = Broken(root)
    document = read_json(broken.layout.document, DatasetDocument)
    write_json(broken.layout.document, document.model_copy(update={"licence": "CC BY 4.0"}))
    rig = read_json(broken.layout.rig("rig"), Rig)
    cameras = tuple(camera.model_copy(update={"static_mask": f"rig.{camera.name}.png"}) for camera in rig.cameras)
    write_json(broken.layout.rig("rig"), rig.model_copy(update={"cameras": cameras}))
    for camera in cameras:
        write_bytes(root / "rigs" / str(camera.static_mask), png(np.zeros(SIZE[::-1], np.uint8)))
    for traversal_id in broken.traversals:
        _images(broken, traversal_id)
        _layers(builder, broken, traversal_id)
        broken.rows(traversal_id, "calibrations", _symmetric)
    for drive in ("d0", "d1", "d2"):
        broken.rows(drive, "passes", _with_refused)
    broken.seal()
    make_split(root, "s", NovelTraversal(train=1), scenes=["a"])
    return root


def png(pixels: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", pixels)[1])


def jpeg(seed: int, size: tuple[int, int] = SIZE) -> bytes:
    """An image like no other."""
    pixels = np.random.default_rng(seed).integers(0, 256, (*size[::-1], 3), dtype=np.uint8)
    return bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 60])[1])


def _images(broken: Broken, traversal_id: str) -> None:
    number = broken.traversals.index(traversal_id)

    def change(rows: TableRows) -> TableRows:
        for index, row in enumerate(rows):
            data = jpeg(1000 * number + index)
            write_bytes(broken.root / row["uri"], data)
            row |= {"byte_length": len(data), "sha256": hashlib.sha256(data).digest(), "privacy": "redacted"}
        return sorted(rows, key=lambda row: (row["camera"], row["timestamp_ns"]))

    broken.rows(traversal_id, "images", change)


def _layers(builder: Builder, broken: Broken, traversal_id: str) -> None:
    images = broken.read(traversal_id, "images")
    stamps = [row["timestamp_ns"] for row in images if row["camera"] == "front_wide"][:5]
    # A car that keeps its distance at 10 m/s, and a parked one that is passed.
    boxes = []
    for number, stamp in enumerate(stamps):
        boxes.append(box(stamp, "ahead", tx_m=15.0, vx_mps=10.0))
        boxes.append(box(stamp, "parked", tx_m=50.0 - 10.0 * number, ty_m=1.0))
    builder.layer(traversal_id, "boxes", "petr@1", BOXES, boxes)
    data = png(np.zeros(SIZE[::-1], np.uint8))
    folder = broken.layout.layer(traversal_id, "masks", "sam", "2.1")
    masks = []
    for row in images[:3]:
        path = folder / f"{row['camera']}_{row['timestamp_ns']}.png"
        write_bytes(path, data)
        masks.append(
            {
                "camera": row["camera"], "timestamp_ns": row["timestamp_ns"], "kind": "dynamic",
                "uri": path.relative_to(broken.root).as_posix(), "byte_length": len(data),
                "sha256": hashlib.sha256(data).digest(), "source": "sam", "source_version": "2.1",
            }
        )  # fmt: skip
    builder.layer(traversal_id, "masks", "sam@2.1", MASKS, masks)
    depth = LayerWriter(broken.layout, traversal_id, "depth", "sweep", "1")
    maps = [
        {
            "camera": row["camera"], "timestamp_ns": row["timestamp_ns"], "width_px": 6, "height_px": 4,
            "fx_px": 5.0, "fy_px": 5.0, "cx_px": 3.0, "cy_px": 2.0,
            **depth.file(f"{row['camera']}/{row['timestamp_ns']}.png", encode_depth(np.full((4, 6), 7.0 + number))),
        }
        for number, row in enumerate(images[:3])
    ]  # fmt: skip
    depth.finish(DEPTH, maps, {})
    points = [
        {
            "point": number, "x_m": 1.0, "y_m": 2.0, "z_m": 0.1 * number, "r": 10, "g": 20, "b": 30,
            "kind": ("ground", "background", "far")[number], "views": 3, "sigma_m": None if number else 0.1,
        }
        for number in range(3)
    ]  # fmt: skip
    LayerWriter(broken.layout, traversal_id, "points", "sweep", "1").finish(POINTS, points, {})
    # This file stands for the sweeps of the fleet, which lie outside of the dataset.
    sweeps = [
        {
            "sensor": "top", "timestamp_ns": stamp, "format": "dgp_npz", "uri": str(Path(__file__).absolute()),
            "byte_length": None, "sha256": None, "qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "tx_m": 0.9, "ty_m": 0.0,
            "tz_m": 1.8,
        }
        for stamp in stamps
    ]  # fmt: skip
    builder.layer(traversal_id, "lidars", "recorded@1", LIDARS, sweeps)


def _symmetric(rows: TableRows) -> TableRows:
    for row in rows:
        row["ty_m"] = {"front_wide": 0.0, "front_left": 0.5, "front_right": -0.5}[row["camera"]]
    return sorted(rows, key=lambda row: (row["camera"], row["stage"]))


def _with_refused(rows: TableRows) -> TableRows:
    before = rows[0]["entry_ns"] - 100 * SECOND
    refused = {
        **rows[0], "traversal_id": None, "decision": "refused", "rule": "min_duration", "measured": 4.0,
        "threshold": 10.0, "entry_ns": before, "exit_ns": before + 4 * SECOND, "duration_s": 4.0, "path_m": 40.0,
        "inside_path_m": 40.0, "mean_speed_mps": 10.0,
    }  # fmt: skip
    return [refused, *rows]


class Broken:
    """A dataset to be broken: edits of its tables and documents, and the sealing of what follows from them."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.layout = Layout(root)

    @property
    def traversals(self) -> list[str]:
        return sorted(folder.name for folder in (self.root / "traversals").iterdir())

    def path(self, name: str, table: str) -> Path:
        """A table: of a traversal (recorded), a drive, or a folder of the dataset."""
        if name in self.traversals:
            return self.layout.recorded(name) / f"{table}.parquet"
        if (self.layout.drive(name)).is_dir():
            return self.layout.drive(name) / f"{table}.parquet"
        return self.root / name / f"{table}.parquet"

    def read(self, name: str, table: str) -> TableRows:
        rows: TableRows = pq.read_table(self.path(name, table)).to_pylist()
        return rows

    def rows(self, name: str, table: str, change: Callable[[TableRows], TableRows]) -> None:
        """Change the rows of a table; `seal` afterwards."""
        spec = TABLES[table]
        write_bytes(self.path(name, table), encode_rows(change(self.read(name, table)), spec))

    def set(self, name: str, table: str, where: int | Iterable[int], **values: object) -> None:
        """Set values in some rows; a callable gets the row."""
        chosen = {where} if isinstance(where, int) else set(where)

        def change(rows: TableRows) -> TableRows:
            for index in chosen & set(range(len(rows))):
                row = rows[index]
                row |= {key: value(row) if callable(value) else value for key, value in values.items()}
            return rows

        self.rows(name, table, change)

    def document(self, path: str, change: Callable[[dict[str, Any]], object]) -> None:
        """Change a JSON document."""
        import json

        file = self.root / path
        raw = json.loads(file.read_bytes())
        change(raw)
        write_json(file, raw)

    def seal(self) -> None:
        """Bring manifests and the index up to what the tables say now, as a faulty writer would leave them."""
        for traversal_id in self.traversals:
            for folder in (self.layout.recorded(traversal_id), *self.layout.traversal(traversal_id).glob("layers/*/*")):
                self._reseal(folder)
        for folder in self.root.glob("maps/*"):
            self._reseal(folder)
        for drive in self.layout.drive_ids():
            folder = self.layout.drive(drive)
            self._reseal(folder)
            manifest = read_manifest(folder)
            assert manifest is not None
            hashes = {
                key: manifest_sha256(self.layout.recorded(key.removeprefix("traversal:")))
                for key in manifest.derived_from
                if key.startswith("traversal:") and (self.layout.recorded(key[10:]) / MANIFEST).exists()
            }
            updated = manifest.model_copy(update={"derived_from": {**manifest.derived_from, **hashes}})
            write_json(folder / MANIFEST, updated)
        for path in self.root.glob("splits/*.json"):
            self._follow(path)
        # Some edits leave nothing that an index could be derived from.
        with suppress(MirrorError):
            build_index(self.root)

    def _reseal(self, folder: Path) -> None:
        manifest = read_manifest(folder) if (folder / MANIFEST).exists() else None
        if manifest is None:
            return
        files = {}
        for name in manifest.files:
            data = (folder / name).read_bytes()
            files[name] = FileEntry(bytes=len(data), sha256=sha256_bytes(data))
        images = manifest.pictures
        if images is not None:
            lengths = [row["byte_length"] for row in pq.read_table(folder / "images.parquet").to_pylist()]
            images = ImageTotals(count=len(lengths), bytes=sum(lengths))
        write_json(folder / MANIFEST, Manifest(derived_from=manifest.derived_from, files=files, pictures=images))

    def _follow(self, path: Path) -> None:
        """A split that knows the manifests as they are now."""

        def change(raw: dict[str, Any]) -> None:
            for key in raw["manifests"]:
                if (self.layout.recorded(key) / MANIFEST).exists():
                    raw["manifests"][key] = read_json(self.layout.recorded(key) / MANIFEST, Manifest).content

        self.document(path.relative_to(self.root).as_posix(), change)
