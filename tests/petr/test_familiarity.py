"""The test of input statistics: synthetic streets are familiar, other images are not, and outputs state it."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")

import mirror
from hybridworldsim.petr.tiny.annotator import ANNOTATOR, SHIPPED, SHIPPED_SHA256
from hybridworldsim.petr.tiny.familiarity import (
    NAME,
    FamiliarInputs,
    fit_inputs,
    read_inputs,
    write_inputs,
)
from hybridworldsim.petr.tiny.samples import camera_input
from hybridworldsim.petr.tiny.settings import NetworkSettings
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError

SIZE = NetworkSettings().width_px, NetworkSettings().height_px


@pytest.fixture(scope="module")
def streets(tiny_dataset: Dataset) -> np.ndarray:
    """Images of a synthetic street in the network's size."""
    return np.concatenate([camera_input(frame, NetworkSettings()).images for frame in tiny_dataset.frames()[:6]])


@pytest.fixture(scope="module")
def shipped() -> FamiliarInputs:
    inputs = read_inputs(SHIPPED.with_name(NAME), SHIPPED_SHA256)
    assert inputs is not None
    return inputs


def test_streets_are_familiar_and_other_images_are_not(shipped: FamiliarInputs, streets: np.ndarray) -> None:
    assert "synthetic streets" in shipped.trained_on
    assert shipped.are_unfamiliar(streets).mean() <= 0.1
    noise = np.random.default_rng(1).integers(0, 256, (4, SIZE[1], SIZE[0], 3), np.uint8)
    flat, grey = np.full((2, SIZE[1], SIZE[0], 3), 255, np.uint8), np.repeat(streets[..., 1:2], 3, axis=3)
    for images in (noise, flat, grey):
        distances = shipped.distances(images)
        assert np.isfinite(distances).all()
        assert (distances > shipped.limit).mean() >= 0.95


@pytest.mark.parametrize("pattern", ["dgp_scene_02/rgb/*/*", "kitti_raw_91/*.jpg", "kitti_odometry_a/sequences/*/*/*"])
def test_real_images_are_unfamiliar(shipped: FamiliarInputs, pattern: str) -> None:
    root = Path(os.environ.get("MIRROR_REAL_DATA", "../shared/data"))
    paths = sorted(root.glob(pattern))[::3]
    if not paths:
        pytest.skip(f"no real images at {root / pattern}: set MIRROR_REAL_DATA")
    images = [cv2.resize(cv2.imread(str(path)), SIZE, interpolation=cv2.INTER_AREA)[..., ::-1] for path in paths]
    assert shipped.are_unfamiliar(np.stack(images)).mean() >= 0.95


def test_inputs_of_another_model_are_refused(streets: np.ndarray, tmp_path: Path) -> None:
    fitted = fit_inputs(streets, "a" * 64, "a test")
    write_inputs(tmp_path / NAME, fitted)
    assert read_inputs(tmp_path / NAME, "a" * 64) == fitted
    assert read_inputs(tmp_path / "other.json", "a" * 64) is None
    with pytest.raises(UsageError, match="aaaaaaaa"):
        read_inputs(tmp_path / NAME, "b" * 64)


def test_output_layer_and_report_state_the_training_data(
    one_drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = one_drive
    verb = ["annotate", str(root), "--annotator", "petr-tiny"]
    assert main(verb) == 0
    assert "petr-tiny was trained on synthetic streets" in capsys.readouterr().out
    (document, *_) = sorted(root.glob("traversals/*/layers/boxes/petr-tiny@*/training_data.json"))
    stated = json.loads(document.read_text())
    assert "synthetic streets" in stated["trained_on"] and stated["unfamiliar_ns"] == []
    assert main(["check", str(root), "--rule", "DS"]) in (0, 1)
    # The same network with the inputs of other images: every frame is unfamiliar.
    model = tmp_path / "model"
    model.mkdir()
    shutil.copy(SHIPPED, model / SHIPPED.name)
    noise = np.random.default_rng(1).integers(0, 256, (40, SIZE[1], SIZE[0], 3), np.uint8)
    write_inputs(model / NAME, fit_inputs(noise, SHIPPED_SHA256, "noise"))
    words = ["--set", f"weights={model / SHIPPED.name}", "--version", "noise"]
    capsys.readouterr()
    assert main([*verb, *words]) == 0
    out = capsys.readouterr().out
    frames = len(mirror.open(root).frames())
    assert f"trained on noise; {frames} of {frames} frames do not look like that" in out
    assert "mirror annotate train" in out
    page = tmp_path / "boxes.html"
    assert main(["annotate", "report", str(root), "--boxes", "petr-tiny@noise", "--out", str(page)]) == 0
    assert f"{frames} of {frames} frames do not look like that" in page.read_text()
    assert "unlike the images that the annotator was trained on" in page.read_text()


def test_a_model_without_inputs_states_nothing(tiny_dataset: Dataset, tmp_path: Path) -> None:
    shutil.copy(SHIPPED, tmp_path / "model.safetensors")
    annotator = ANNOTATOR.open(tiny_dataset, {"weights": str(tmp_path / "model.safetensors")}, "cpu")
    assert getattr(annotator, "trained_on", None) is None
    assert not annotator.annotate(tiny_dataset.frames()[0]).unfamiliar
