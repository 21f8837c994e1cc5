"""A recording with a rolling shutter through the verbs, from `mirror synth` to the scores of held-out frames."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from benchmarks.rasterizer.rolling_recorded import PRESET, QUICK, SPLIT, WAYS, call, prepare, train, write_protocol
from mirror.synth import PRESETS
from tests.builders.lanes import add_initial_points

SIZE = QUICK._replace(width_px=48, image_hz=0.25, steps=3, initialise="made@1")


@pytest.fixture(autouse=True)
def _preset() -> Iterator[None]:
    """Remove the preset of the benchmark afterwards."""
    yield
    PRESETS.pop(PRESET, None)


def _read_renders(folder: Path) -> np.ndarray:
    """Read the renders (V, H, W, 3) of a submission, in the order of their paths."""
    images = [cv2.imread(str(path)) for path in sorted(folder.glob("renders/**/*.png"))]
    return np.stack([image for image in images if image is not None]).astype(float)


def test_a_recorded_shutter_is_trained_with_rendered_and_scored(tmp_path: Path) -> None:
    dataset = prepare(tmp_path, WAYS[1], SIZE)
    image = mirror.open(dataset).frames()[0].images["front_wide"]
    assert (image.shutter.direction, image.shutter.readout_ns) == ("top_to_bottom", 30_000_000)
    add_initial_points(mirror.open(dataset), SPLIT)
    assert train(dataset, tmp_path / "run", SIZE)["psnr"] > 5.0
    # the same model at mid-exposure: rows at the edges of the image differ, by a protocol of another hash
    words = ("--split", SPLIT, "--protocol", write_protocol(tmp_path, SIZE, "global"), "--out", tmp_path / "still")
    call("render", dataset, tmp_path / "run" / "model", *words)
    submissions = tmp_path / "run" / "submission", tmp_path / "still"
    plans = [json.loads((folder / "manifest.json").read_text()) for folder in submissions]
    assert plans[0]["protocol_hash"] != plans[1]["protocol_hash"]
    rolled, still = (_read_renders(folder) for folder in submissions)
    assert len(rolled) and rolled.shape == still.shape
    assert np.abs(rolled - still).max() > 2.0
