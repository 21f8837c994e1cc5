"""Options of `mirror generate scene`: guidance, half precision, and images in files as backgrounds."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hybridworldsim.generation.command import main
from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, ExitCode

CAMERAS = ("front_wide", "front_left")
FRAMES, T = 2, 5
# Generated images are 24 x 16; backgrounds have twice their sides.
SHAPE = (32, 48, 3)


@pytest.fixture(scope="module")
def backgrounds(tiny_dataset: Dataset, traversal: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An image of one colour for each camera and instant, in the folders that ``files:`` reads."""
    folder = tmp_path_factory.mktemp("backgrounds")
    for frame in tiny_dataset.where(traversal=traversal).frames():
        for camera in CAMERAS:
            file = folder / camera / f"{frame.timestamp_ns}.png"
            file.parent.mkdir(exist_ok=True)
            assert cv2.imwrite(str(file), np.full(SHAPE, colour(camera, frame.timestamp_ns)[::-1], np.uint8))
    return folder


def colour(camera: str, timestamp_ns: int) -> UInt8:
    """Another one for each camera and instant."""
    return np.random.default_rng([CAMERAS.index(camera), timestamp_ns]).integers(40, 200, 3).astype(np.uint8)


def generate(dataset: Dataset, traversal: str, models: Path, backgrounds: Path, out: Path, *more: str) -> None:
    words = ["scene", str(dataset.root), str(models), "--background", f"files:{backgrounds}", "--size", "24x16"]
    words += ["--traversal", traversal, "--cameras", ",".join(CAMERAS), "--frames", str(FRAMES), "--steps", "2"]
    assert main([*words, "--out", str(out), "--json", *more]) == ExitCode.DONE


def images(out: Path) -> UInt8:
    """(FRAMES, V, H, W, 3)"""
    files = [[out / "frames" / camera / f"{number:05d}.png" for camera in CAMERAS] for number in range(FRAMES)]
    return np.stack([[cv2.imread(str(file))[..., ::-1] for file in row] for row in files])


@pytest.fixture(scope="module")
def plain(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, tmp_path_factory: pytest.TempPathFactory
) -> UInt8:
    """The frames without options."""
    out = tmp_path_factory.mktemp("plain") / "out"
    generate(tiny_dataset, traversal, models, backgrounds, out, "--no-keep-empty-views")
    return images(out)


def test_files_are_the_background_of_their_camera_and_instant(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, tmp_path: Path
) -> None:
    frames = tiny_dataset.where(traversal=traversal).frames()
    removed = [f"--edit=remove:{name}" for name in sorted({name for one in frames for name in one.boxes().track_id})]
    generate(tiny_dataset, traversal, models, backgrounds, tmp_path / "out", *removed)
    found = images(tmp_path / "out")
    # The first T frames are seeds. The recording is slower than 5 Hz: no frame is left out.
    for place, one in enumerate(frames[T : T + FRAMES]):
        for row, camera in enumerate(CAMERAS):
            assert (found[place, row] == colour(camera, one.timestamp_ns)).all()


def test_a_missing_file_and_one_of_another_size_are_named(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match="no background image") as caught:
        generate(tiny_dataset, traversal, models, backgrounds / CAMERAS[0], tmp_path / "out")
    assert str(caught.value.place).startswith("camera front_wide, timestamp_ns ")
    assert caught.value.expected == "a PNG of 48 x 32 px"
    with pytest.raises(DatasetError, match="a background of 48 x 32 px"):
        generate(tiny_dataset, traversal, models, backgrounds, tmp_path / "large", "--size", "32x16")
    assert not list(tmp_path.rglob("generated.json"))


def test_guidance_changes_generated_frames_and_is_written_down(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, plain: UInt8, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    generate(tiny_dataset, traversal, models, backgrounds, out, "--no-keep-empty-views", "--guidance", "4")
    assert "guidance=4.0" in json.loads((out / "generated.json").read_text())["inputs"]["rollout"]
    assert not np.array_equal(images(out), plain)


def test_half_precision_changes_frames_by_a_few_grey_levels(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, plain: UInt8, tmp_path: Path
) -> None:
    generate(
        tiny_dataset, traversal, models, backgrounds, tmp_path / "out", "--no-keep-empty-views", "--precision", "bf16"
    )
    difference = np.abs(images(tmp_path / "out").astype(int) - plain)
    assert 0 < difference.max() <= 8
    assert difference.mean() < 1.0
