"""Options of `mirror generate scene`: guidance, half precision, and images in files as backgrounds."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from hybridworldsim.generation.command import main
from hybridworldsim.generation.model_files import read_generator, trained_rates, write_generator
from hybridworldsim.generation.scenes.backgrounds import open_background
from hybridworldsim.generation.scenes.rig import rig_of
from hybridworldsim.generation.scenes.run import PIXELS
from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, ExitCode, UsageError
from mirror.geometry import project_boxes
from mirror.methods.hosting import reconstruct
from mirror.methods.plugin import ReconstructionTask
from mirror.methods.registry import load_method
from mirror.progress import NullProgress
from mirror.protocols.document import load_protocol
from mirror.protocols.views import plan_views
from tests.conftest import ROOT

CAMERAS = ("front_wide", "front_left")
FRAMES, T = 2, 5
EVERYWHERE = ("--no-keep-empty-views", "--blend", "none")
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
    generate(tiny_dataset, traversal, models, backgrounds, out, *EVERYWHERE)
    return images(out)


def test_files_are_the_background_of_their_camera_and_instant(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, tmp_path: Path
) -> None:
    frames = tiny_dataset.where(traversal=traversal).frames()
    removed = [f"--edit=remove:{name}" for name in sorted({name for one in frames for name in one.boxes().track_id})]
    generate(tiny_dataset, traversal, models, backgrounds, tmp_path / "out", *removed)
    found = images(tmp_path / "out")
    document = json.loads((tmp_path / "out" / "generated.json").read_text())
    assert "blend_px=4" in document["inputs"]["rollout"]
    # The tiny dataset has a frame every two seconds; the generator saw five a second.
    assert (document["rate_hz"], document["trained_rates_hz"]) == (pytest.approx(0.5), [5.0, 5.0])
    assert document["rate_note"].startswith("frames are generated at 0.5 Hz, the generator was trained at 5 Hz")
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
    with pytest.raises(DatasetError, match="a background of 48 x 32 px") as caught:
        generate(tiny_dataset, traversal, models, backgrounds, tmp_path / "large", "--size", "32x16")
    assert str(caught.value.file).endswith(".png") and caught.value.expected == "a PNG of 64 x 32 px"
    # The last one is missing: it is named before the first frame is generated.
    last = tiny_dataset.where(traversal=traversal).frames()[T + FRAMES - 1]
    partial = shutil.copytree(backgrounds, tmp_path / "partial")
    (partial / CAMERAS[1] / f"{last.timestamp_ns}.png").write_bytes(b"no image")
    with pytest.raises(DatasetError, match="no PNG") as caught:
        generate(tiny_dataset, traversal, models, partial, tmp_path / "out")
    assert str(last.timestamp_ns) in str(caught.value.place)
    assert not any((tmp_path / name).exists() for name in ("out", "large"))


def test_files_in_the_raster_of_a_protocol_are_scaled_to_that_of_the_generator(
    tiny_dataset: Dataset, tmp_path: Path
) -> None:
    plan = plan_views(tiny_dataset, load_protocol("generation"), "novel")
    view = plan.views[0]
    file = tmp_path / view.camera / f"{view.timestamp_ns}.png"
    file.parent.mkdir()
    ramp = np.linspace(0, 255, view.width_px).round().astype(np.uint8)
    assert cv2.imwrite(str(file), np.tile(ramp[None, :, None], (view.height_px, 1, 3)))
    background, _ = open_background(f"files:{tmp_path}", tiny_dataset, "nearest", [view])
    np.testing.assert_array_equal(background(view)[0, :, 0], ramp)
    # What is generated again after an interruption depends on the files, not on the name of their folder.
    _, before = open_background(f"files:{tmp_path}", tiny_dataset, "nearest", [view])
    assert cv2.imwrite(str(file), np.tile(ramp[None, ::-1, None], (view.height_px, 1, 3)))
    _, after = open_background(f"files:{tmp_path}", tiny_dataset, "nearest", [view])
    assert before != after
    assert cv2.imwrite(str(file), np.tile(ramp[None, :, None], (view.height_px, 1, 3)))
    small = background(view.model_copy(update={"width_px": view.width_px // 2, "height_px": view.height_px // 2}))
    assert small.shape == (view.height_px // 2, view.width_px // 2, 3)
    np.testing.assert_allclose(small[0, :, 0], ramp.reshape(-1, 2).mean(axis=1), atol=1.0)


def test_generated_pixels_are_used_near_boxes_alone(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, plain: UInt8, tmp_path: Path
) -> None:
    options = ("--no-keep-empty-views", "--blend", "0")
    generate(tiny_dataset, traversal, models, backgrounds, tmp_path / "out", *options)
    found, frames = images(tmp_path / "out"), tiny_dataset.where(traversal=traversal).frames()
    rig, used = rig_of(frames, CAMERAS, (16, 24), PIXELS), 0
    for place, one in enumerate(frames[T : T + FRAMES]):
        boxes = one.boxes("ego")
        for row, camera in enumerate(CAMERAS):
            street = colour(camera, one.timestamp_ns)
            changed = (found[place, row] != street).any(axis=2)
            np.testing.assert_array_equal(found[place, row][changed], plain[place, row][changed])
            seen = project_boxes(rig.rasters[row].final, rig.ego_SE3_camera[row].inverse() @ boxes.pose, boxes.size_m)
            near = np.zeros(changed.shape, bool)
            for left, top, right, bottom in seen.bounds_px[seen.visible]:
                near[max(int(top), 0) : int(bottom) + 1, max(int(left), 0) : int(right) + 1] = True
            assert not changed[~near].any()
            used += int(changed.sum())
    assert used > 5
    with pytest.raises(UsageError, match="'wide'; expected pixels, such as 4, or none") as caught:
        generate(tiny_dataset, traversal, models, backgrounds, tmp_path / "other", "--blend", "wide")
    assert caught.value.place == "--blend"


def test_guidance_changes_generated_frames_and_is_written_down(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, plain: UInt8, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    generate(tiny_dataset, traversal, models, backgrounds, out, *EVERYWHERE, "--guidance", "4")
    assert "guidance=4.0" in json.loads((out / "generated.json").read_text())["inputs"]["rollout"]
    assert not np.array_equal(images(out), plain)


def test_a_generator_that_was_never_trained_without_boxes_is_not_guided(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, tmp_path: Path
) -> None:
    file = tmp_path / "generator" / "model.safetensors"
    write_generator(file, *read_generator(models / "generator" / "model.safetensors"))
    assert trained_rates(file) is None
    shutil.copytree(models / "autoencoder", tmp_path / "autoencoder")
    with pytest.raises(UsageError, match="guidance 4") as caught:
        generate(tiny_dataset, traversal, tmp_path, backgrounds, tmp_path / "out", "--guidance", "4")
    assert (caught.value.file, caught.value.place) == (str(file), "--guidance")
    assert not (tmp_path / "out").exists()


def test_half_precision_changes_frames_by_a_few_grey_levels(
    tiny_dataset: Dataset, traversal: str, models: Path, backgrounds: Path, plain: UInt8, tmp_path: Path
) -> None:
    generate(tiny_dataset, traversal, models, backgrounds, tmp_path / "out", *EVERYWHERE, "--precision", "bf16")
    difference = np.abs(images(tmp_path / "out").astype(int) - plain)
    assert 0 < difference.max() <= 8
    assert difference.mean() < 1.0


def test_a_background_is_a_model_of_a_method_in_a_file(
    tiny_dataset: Dataset, traversal: str, models: Path, tmp_path: Path
) -> None:
    shutil.copy(ROOT / "examples" / "method.py", tmp_path)
    method, model = f"{tmp_path / 'method.py'}:METHOD", tmp_path / "model"
    scene = str(tiny_dataset.where(traversal=traversal).scenes()[0])
    task = ReconstructionTask(scene, "novel", load_protocol("static-reconstruction"))
    reconstruct(method, load_method(method), tiny_dataset, task, model, NullProgress())
    words = ["scene", str(tiny_dataset.root), str(models), "--background", str(model), "--traversal", traversal]
    words += ["--frames", "1", "--size", "24x16", "--out", str(tmp_path / "out")]
    with pytest.raises(UsageError) as refused:
        main(words)
    assert refused.value.place == "--method" and refused.value.remedy == "add --method FOLDER/method.py:METHOD"
    assert main([*words, "--method", method]) == ExitCode.DONE
    assert len(list((tmp_path / "out" / "frames").rglob("*.png"))) == len(tiny_dataset.cameras())
    with pytest.raises(UsageError, match="a static model as background"):
        main([*words, "--background", "exact:tiny", "--method", method])
