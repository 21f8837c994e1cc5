"""A board with reported and measured entries and images."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.dataset.dataset import Dataset
from mirror.protocols.document import load_protocol
from mirror.schema.files import write_json
from mirror_leaderboard.command import PAPERS
from mirror_leaderboard.entry import IMAGE_FOLDER, Figure, Measured, Pair
from mirror_leaderboard.signing import new_key
from mirror_leaderboard.trust import sign_entries

REPOSITORY = Path(__file__).parents[2]
MEASURED = REPOSITORY / "leaderboard" / "entries"
REPORTED = PAPERS / "entries"


NO_LPIPS = "unavailable: alexnet weights (docs/weights.md)"


def measured(method: str, psnr: float, *, lpips: float | None = None, **changes: object) -> Measured:
    protocol = load_protocol("static-reconstruction")
    figures = (
        Figure(group="training", metric="psnr", value=psnr + 2, low=psnr + 1.5, high=psnr + 2.5, n=70),
        Figure(group="novel", metric="psnr", value=psnr, low=psnr - 0.5, high=psnr + 0.5, n=35, n_infinite=1),
        Figure(group="novel", metric="matched_structure", value=psnr / 50, low=psnr / 51, high=psnr / 49, n=35),
        Figure(group="novel", metric="psnr_invariant", value=psnr + 3, low=psnr + 2.5, high=psnr + 3.5, n=35),
        Figure(group="novel", metric="psnr_cc", value=psnr + 1, low=psnr + 0.5, high=psnr + 1.5, n=35),
        Figure(group="novel", metric="ssim", value=psnr / 40, low=psnr / 41, high=psnr / 39, n=35),
        Figure(group="novel", metric="lpips_alex", value=lpips, note=None if lpips else NO_LPIPS),
    )
    plain = {
        "method": method,
        "version": "1",
        "protocol": protocol.name,
        "protocol_version": protocol.version,
        "protocol_hash": protocol.hash,
        "dataset": "synthetic street",
        "dataset_hash": "ab" * 32,
        "split": "novel",
        "result_hash": "cd" * 32,
        "toolkit": "mirror 0.1.0",
        "frames_per_second": 400.0 / psnr,
        "figures": figures,
        "pairs": tuple(
            Pair(
                view=f"view {number}",
                render=f"street/{re.sub('[^a-z0-9_]', '', method.lower())}-{number}.jpg",
                truth=f"street/truth-{number}.jpg",
            )
            for number in range(2)
        ),
        **changes,
    }
    return Measured.model_validate(plain).sealed()


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """A signed board with entries and images; its key is beside it."""
    folder = tmp_path / "board"
    shutil.copytree(REPORTED, folder / "entries")
    scores = (("nearest_frame", 12.5, None), ("mean_color", 11.25, 0.6), ("HybridWorldSim", 19.75, None))
    for method, psnr, lpips in scores:
        write_json(folder / "entries" / f"measured-{method}.json", measured(method, psnr, lpips=lpips))
    (folder / IMAGE_FOLDER / "street").mkdir(parents=True)
    for number, name in enumerate(("truth", "nearest_frame", "mean_color", "HybridWorldSim")):
        for view in range(2):
            image = np.full((270, 480, 3), (60 * number, 90, 220 - 60 * view), np.uint8)
            cv2.putText(image, f"{name} {view}", (20, 140), cv2.FONT_HERSHEY_SIMPLEX, 1.2, (255, 255, 255), 2)
            cv2.imwrite(str(folder / IMAGE_FOLDER / "street" / f"{name.lower()}-{view}.jpg"), image)
    new_key(tmp_path / "organiser.key")
    sign_entries(folder, tmp_path / "organiser.key")
    return folder


@pytest.fixture(scope="session")
def dataset(tiny_dataset: Dataset) -> Dataset:
    return tiny_dataset


@pytest.fixture(scope="session")
def root(tiny_dataset: Dataset) -> Path:
    return Path(tiny_dataset.root)
