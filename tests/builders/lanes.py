"""A street of three lanes: training drives in both directions and a held-out drive, each with its own colour."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

import mirror
from mirror.dataset import Dataset
from mirror.dataset.images.depth_codec import encode_depth
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.schema.documents import NovelTraversal, SplitDocument
from mirror.schema.files import write_json
from mirror.schema.tables import BOXES, DEPTH, POINTS
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box

CAMERAS = ("front_wide", "front_left")
# Drive, lane in metres to the left, heading, colour (RGB), role.
DRIVES = (
    ("near", 3.0, 30.0, (200, 40, 40), "train"),
    ("far", 9.0, 30.0, (40, 200, 40), "train"),
    ("oncoming", 0.5, 210.0, (40, 40, 200), "train"),
    ("new", 0.0, 30.0, (120, 120, 120), "held_out"),
)
FRAMES = 12


def encode_constant_image(colour: tuple[int, int, int]) -> bytes:
    pixels = np.full((32, 48, 3), colour[::-1], np.uint8)
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()


def write_lanes(root: Path) -> Path:
    """Write the dataset of the street, with boxes and the split ``novel``, and return its folder."""
    builder = Builder(root, cameras=CAMERAS)
    builder.scene("street")
    roles = {}
    for number, (name, lane, heading, colour, role) in enumerate(DRIVES):
        data = encode_constant_image(colour)
        entry = EPOCH + number * 3600 * SECOND
        one = Pass(
            "street",
            entry_ns=entry,
            frames=FRAMES,
            heading_deg=heading,
            # To the left of the street, for both driving directions.
            offset_m=lane if heading < 180 else -lane,
            images=dict.fromkeys(CAMERAS, data),
        )
        (traversal,) = builder.drive(name, [one])
        stamps = range(entry, one.exit_ns, one.frame_ns)
        builder.layer(traversal, "boxes", "petr@1", BOXES, [box(stamp, "a", tx_m=-90.0) for stamp in stamps])
        roles[traversal] = role
    split = SplitDocument(
        name="novel",
        parameters=NovelTraversal(),
        seed=0,
        scenes=None,
        dataset_hash="12" * 32,
        manifests=dict.fromkeys(roles, "34" * 32),
        assignments=roles,
    )
    write_json(builder.root / "splits" / "novel.json", split)
    build_index(builder.root)
    return builder.root


def add_initial_points(made: Dataset, split: str = "novel") -> Dataset:
    """Add points of its training traversals, a wall on either side, and a depth map of each, as `mirror reconstruct`
    reads them."""
    train = made.where(split=split, role="train")
    poses = train.table("ego_poses", ["tx_m", "ty_m", "tz_m"])
    x, y, z = (column.to_numpy() for column in poses.columns)
    rng = np.random.default_rng(0)
    for traversal in train.traversals():
        rows = [
            {
                "point": number,
                "x_m": float(x.mean() + rng.uniform(-40, 40)),
                "y_m": float(y.mean() + rng.choice((-12.0, 12.0))),
                "z_m": float(z.mean() + rng.uniform(0, 8)),
                "r": 90, "g": 90, "b": 90, "kind": "background", "views": 3, "sigma_m": None,
            }
            for number in range(150)
        ]  # fmt: skip
        layout = Layout(Path(made.root))
        LayerWriter(layout, traversal, "points", "made", "1").finish(POINTS, rows, {})
        image = made.where(traversal=traversal).frames()[0].images["front_wide"]
        depth = LayerWriter(layout, traversal, "depth", "made", "1")
        lens = {"width_px": 6, "height_px": 4, "fx_px": 5.0, "fy_px": 5.0, "cx_px": 3.0, "cy_px": 2.0}
        key = {"camera": "front_wide", "timestamp_ns": image.timestamp_ns}
        flat = depth.file("map.png", encode_depth(np.full((4, 6), 9.0)))
        depth.finish(DEPTH, [{**key, **lens, **flat}], {})
    build_index(Path(made.root))
    return mirror.open(made.root)
