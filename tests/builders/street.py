"""A small scene for exports: five lenses, boxes that turn, masks and points, the same bytes wherever it is made."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

import mirror
from mirror.dataset.dataset import Dataset
from mirror.dataset.index.build import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.geometry.cameras import Camera
from mirror.schema.documents import SplitDocument
from mirror.schema.files import write_json
from mirror.schema.tables import BOXES, MASKS, POINTS
from tests.builders.dataset import EPOCH, Builder, Pass, box

SIZE = (192, 128)
LENSES = {
    "front_wide": Camera("pinhole", *SIZE, 150.0, 151.0, 95.3, 64.8),
    "front_narrow": Camera("brown_conrady", *SIZE, 210.0, 211.0, 96.1, 63.2, (-0.11, 0.02, 0.001, -0.002, 0.0)),
    "front_left": Camera("brown_conrady", *SIZE, 160.0, 160.0, 97.0, 64.5, (-0.1, 0.03, 0.001, -0.0005, -0.01)),
    "front_right": Camera(
        "rational", *SIZE, 140.0, 141.0, 96.0, 64.0, (0.3, 0.05, 0.0003, -0.0002, 0.001, 0.5, 0.1, 0.008)
    ),
    "rear": Camera("kannala_brandt", *SIZE, 70.0, 70.5, 96.5, 63.5, (-0.012, 0.004, -0.002, 0.0)),
    "rear_left": Camera("f_theta", *SIZE, 1.0, 1.0, 95.0, 65.0, (0.0, 70.0, 0.5, -0.2)),
}  # fmt: skip
PINHOLES = ("front_wide",)
SECOND = 1_000_000_000


def encoded(camera: str, drive: int) -> bytes:
    """An image whose pixels differ from camera to camera and drive to drive."""
    width, height = SIZE
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    shade = 40 * list(LENSES).index(camera)
    pixels = np.stack([x, y + shade // 4, np.full_like(x, shade + 5 * drive)], axis=-1).astype(np.uint8)
    return cv2.imencode(".jpg", pixels)[1].tobytes()


def make_street(
    root: Path,
    cameras: tuple[str, ...] = tuple(LENSES),
    *,
    speed_mps: float = 10.0,
    frame: str | None = None,
    longitude_deg: float = -79.4,
    encode: Callable[[str, int], bytes] = encoded,
) -> Dataset:
    """Two traversals with 5 frames, on two drives; the first has boxes, masks and points.

    Cameras are exposed 1 ms after each other: at 10 m/s they are no rigid rig, at a few mm/s they are.
    """
    builder = Builder(root, cameras, SIZE, lenses={name: LENSES[name] for name in cameras})
    more = (
        {"frame": frame, "x_m": 5000.0, "y_m": 2000.0} if frame else {"height_m": 30.0, "longitude_deg": longitude_deg}
    )
    builder.scene("a", **more)
    images = [{name: encode(name, drive) for name in cameras} for drive in range(2)]
    (first,) = builder.drive("d0", [Pass("a", images=images[0], speed_mps=speed_mps)])
    later = EPOCH + 86_400 * SECOND
    night = Pass("a", entry_ns=later, images=images[1], speed_mps=speed_mps, offset_m=2.0, light="night")
    (second,) = builder.drive("d1", [night], vehicle_id="v2")
    for traversal_id, start in ((first, EPOCH), (second, later)):
        rows = []
        for number in range(5):
            yaw = 0.1 * number
            place = {"tx_m": 8.0 + number, "ty_m": 1.0, "qw": np.cos(yaw / 2), "qz": np.sin(yaw / 2)}
            rows.append(box(start + number * 100_000_000, "van-1", category="van", score=None, **place))
            rows.append(box(start + number * 100_000_000, "car-2", tx_m=12.0, ty_m=-3.0, score=None))
        builder.layer(traversal_id, "boxes", "petr@1", BOXES, rows)
    masks = LayerWriter(builder.layout, first, "masks", "sam", "1")
    hidden = np.zeros(SIZE[::-1], np.uint8)
    hidden[:20, :30] = 255
    file = masks.file("mask.png", cv2.imencode(".png", hidden)[1].tobytes())
    masks.finish(MASKS, [{"camera": cameras[0], "timestamp_ns": EPOCH, "kind": "dynamic", **file}], {})
    for traversal_id, shift in ((first, 0.0), (second, 50.0)):
        points = [
            {
                **{"point": row, "x_m": 5.0 * row + shift, "y_m": -2.0 * row, "z_m": 0.5 * row},
                **{"r": 10 * row, "g": 20, "b": 30, "kind": "background", "views": 3, "sigma_m": None},
            }
            for row in range(7)
        ]
        LayerWriter(builder.layout, traversal_id, "points", "sweep", "1").finish(POINTS, points, {})
    build_index(root)
    _write_split(builder, first, second)
    return mirror.open(root)


def _write_split(builder: Builder, train: str, held_out: str) -> None:
    from mirror.dataset.splits.split import make_split
    from mirror.schema.documents import NovelTraversal

    make_split(builder.root, "novel", NovelTraversal(train=1, held_out=1))
    path = builder.layout.split("novel")
    document = SplitDocument.model_validate_json(path.read_bytes())
    roles = {train: "train", held_out: "held_out"}
    write_json(path, document.model_copy(update={"assignments": roles, "left_out": {}}))
