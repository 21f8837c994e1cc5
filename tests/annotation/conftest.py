"""A small dataset to annotate."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from mirror.dataset.index.build import build_index
from tests.dataset.builders import Builder, Pass


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import cv2

    root = tmp_path_factory.mktemp("annotation") / "dataset"
    builder = Builder(root, cameras=("front_wide", "rear"))
    builder.scene("a")
    image = cv2.imencode(".jpg", np.full((32, 48, 3), 90, np.uint8))[1].tobytes()
    builder.drive("d0", [Pass("a", frames=4, images={"front_wide": image, "rear": image})])
    builder.drive("d1", [Pass("a", frames=3, heading_deg=200.0, images={"front_wide": image, "rear": image})])
    build_index(root)
    return root


@pytest.fixture
def root(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "dataset"))
