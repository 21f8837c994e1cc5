"""A small dataset for stereo."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.dataset.index import build_index
from mirror.dataset.splits import make_split
from mirror.schema.documents import NovelTraversal
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass
from tests.mvs.level_road import CAMERAS


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("mvs") / "dataset"
    builder = Builder(root, cameras=CAMERAS, size=(96, 64))
    builder.scene("a")
    for number in range(3):
        # make_split keeps traversals with the same bytes together, so each traversal has its own noise.
        noise = np.random.default_rng(number).integers(0, 255, (64, 96, 3)).astype(np.uint8)
        encoded = dict.fromkeys(CAMERAS, bytes(cv2.imencode(".jpg", noise)[1]))
        entry = EPOCH + number * 1000 * SECOND
        builder.drive(f"d{number}", [Pass("a", entry, images=encoded, offset_m=0.5 * number)], vehicle_id=f"v{number}")
    build_index(root)
    make_split(root, "s", NovelTraversal(train=2))
    return root


@pytest.fixture
def dataset(written: Path, tmp_path: Path) -> Path:
    """A copy without layers, which tests may change."""
    return Path(shutil.copytree(written, tmp_path / "dataset"))
