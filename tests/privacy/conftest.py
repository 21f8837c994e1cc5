"""A dataset with known marks instead of faces and plates, and an installed package with detectors of these marks."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.dataset.index import build_index
from mirror.privacy.detectors.registry import parse_choice
from mirror.privacy.options import DeidentifyOptions, Propagation
from mirror.privacy.run import deidentify
from tests.builders.dataset import SECOND, Builder, Pass
from tests.privacy.images import jpeg, pixels

FACE = (20, 10, 36, 30)
"""A mark in every image of `front_wide`: left, top, right, bottom; with that of `rear`, the truth of the dataset."""
PLATE = (60, 40, 90, 50)
_MODULE = '''
"""Detectors of marks: pure red is a face, pure blue a plate; pure green crashes or hangs a detector if so set."""
import os, time
from pathlib import Path
import numpy as np
from mirror.privacy import DetectorKind, Region
from mirror.errors import MirrorError

class Marks:
    version, weights_sha256, threshold = "1", "", 0.5
    def __init__(self, kind, colour, fault=None):
        self.kind, self.name, self.colour, self.fault = kind, kind + "_marks", colour, fault
    def __call__(self, image):
        near = np.abs(image.astype(int) - self.colour).max(axis=-1) < 90
        green = np.abs(image.astype(int) - (0, 255, 0)).max(axis=-1) < 60
        if self.fault and green.any():
            if self.fault == "crash":
                os._exit(7)
            if self.fault == "hang":
                time.sleep(600)
            raise RuntimeError("the detector failed")
        rows, columns = np.nonzero(near)
        if len(rows) < 20:
            return []
        return [Region(kind=self.kind, left_px=float(columns.min()), top_px=float(rows.min()),
                right_px=float(columns.max() + 1), bottom_px=float(rows.max() + 1), score=0.9, source=self.name)]

class TiledMarks(Marks):
    """Searches the whole image as one tile."""
    skipped, skipped_tiles = None, 0
    def __call__(self, image):
        if self.skipped is not None and self.skipped.all():
            self.skipped_tiles += 1
            return []
        return super().__call__(image)

FACES = DetectorKind("face", "red marks", lambda options: Marks("face", (255, 0, 0)))
PLATES = DetectorKind("plate", "blue marks", lambda options: Marks("plate", (0, 0, 255)), frozenset({"XX"}))
TILED = DetectorKind("face", "red marks", lambda options: TiledMarks("face", (255, 0, 0)))
CRASHING = DetectorKind("face", "red marks", lambda options: Marks("face", (255, 0, 0), "crash"))
HANGING = DetectorKind("face", "red marks", lambda options: Marks("face", (255, 0, 0), "hang"))
FAILING = DetectorKind("face", "red marks", lambda options: Marks("face", (255, 0, 0), "fail"))
'''


def install_marks(folder: Path) -> None:
    """Install the package into a folder of packages, as a user would install one with a detector."""
    (folder / "mark_detectors.py").write_text(_MODULE)
    info = folder / "mark_detectors-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mark-detectors\nVersion: 1.0\n")
    names = ("faces", "plates", "tiled", "crashing", "hanging", "failing")
    lines = "".join(f"{name} = mark_detectors:{name.upper()}\n" for name in names)
    (info / "entry_points.txt").write_text(f"[mirror.detectors]\n{lines}")


@pytest.fixture(scope="session", autouse=True)
def marks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Install the package for the tests of this folder."""
    folder = tmp_path_factory.mktemp("site")
    install_marks(folder)
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


def marked(seed: int, *boxes: tuple[tuple[int, int, int, int], tuple[int, int, int]]) -> np.ndarray:
    """A grey image with marks."""
    image = np.repeat((0.5 * pixels(72, 128, seed)[..., :1] + 40).astype(np.uint8), 3, axis=2)
    for (left, top, right, bottom), colour in boxes:
        image[top:bottom, left:right] = colour
        # The detail that must go: stripes.
        image[top:bottom, left:right:4] = np.array(colour) * 0.7
    return image


RED, GREEN, BLUE = (255, 0, 0), (0, 255, 0), (0, 0, 255)


def make_dataset(root: Path, *, green: bool = False, frames: int = 3) -> Builder:
    """Two drives of one scene; `front_wide` shows a face, `rear` a plate and EXIF data, `rear_left` nothing."""
    builder = Builder(root, cameras=("front_wide", "rear", "rear_left"), size=(128, 72))
    builder.scene("a")
    for number, entry in enumerate((1_700_000_000 * SECOND, 1_700_100_000 * SECOND)):
        seed = 10 * number
        images = {
            "front_wide": jpeg(marked(seed + 1, (FACE, RED)), subsampling=0),
            "rear": jpeg(marked(seed + 2, (PLATE, BLUE)), subsampling=0, gps=True, thumbnail=True),
            "rear_left": jpeg(marked(seed + 3, *([((0, 0, 8, 8), GREEN)] if green else [])), comment=True),
        }
        builder.drive(
            f"d{number}",
            [Pass("a", entry, frames=frames, frame_ns=12 * SECOND // frames, images=images)],
            vehicle_id=f"v{number}",
        )
    build_index(root)
    return builder


def options(*detectors: str, **more: object) -> DeidentifyOptions:
    """Options with the detectors of marks."""
    chosen = [parse_choice(text) for text in detectors or ("faces", "plates")]
    given = {"plate_region": "XX", "propagation": Propagation(cameras=False), "workers": 1, **more}
    return DeidentifyOptions(detectors=chosen, **given)


@pytest.fixture(scope="session")
def deidentified(tmp_path_factory: pytest.TempPathFactory, marks: None) -> Path:
    """A de-identified dataset; tests copy it before they change it."""
    root = tmp_path_factory.mktemp("deidentified") / "dataset"
    make_dataset(root)
    assert deidentify(root, options()).exit_code() == 0
    return root


@pytest.fixture
def dataset(deidentified: Path, tmp_path: Path) -> Path:
    """A copy of the de-identified dataset."""
    return Path(shutil.copytree(deidentified, tmp_path / "dataset"))


def write_image(path: Path, image: np.ndarray) -> None:
    """Write an image as it stands."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])
