"""A street of three lanes: training drives in both directions and a held-out drive, each with its own colour."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.protocols.document import Protocol, load_protocol
from mirror.schema.documents import NovelTraversal, SplitDocument
from mirror.schema.files import write_json
from mirror.schema.tables import BOXES
from tests.dataset.builders import EPOCH, SECOND, Builder, Pass, box

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


@pytest.fixture(scope="session")
def made_street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The street as it is written; tests get copies of it."""
    builder = Builder(tmp_path_factory.mktemp("street") / "dataset", cameras=CAMERAS)
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


@pytest.fixture
def dataset(made_street: Path, tmp_path: Path) -> Dataset:
    return mirror.open(shutil.copytree(made_street, tmp_path / "dataset"))


@pytest.fixture
def protocol() -> Protocol:
    """Static reconstruction, scored by PSNR only."""
    plain = load_protocol("static-reconstruction").model_dump(mode="json")
    plain["metrics"] = [{"metric": "psnr"}]
    return Protocol.model_validate(json.loads(json.dumps(plain)))
