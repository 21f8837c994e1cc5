"""Generated scenes over a street that `mirror reconstruct` learned, in each of its appearances."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from hybridworldsim.generation.clips.folder import read_clip, read_list
from hybridworldsim.generation.recorded.documents import HIDDEN
from hybridworldsim.generation.scenes.plan import plan_scene
from hybridworldsim.generation.scenes.rig import rig_of
from hybridworldsim.generation.scenes.run import PIXELS
from hybridworldsim.methods.street import open_model
from mirror.arrays import UInt8
from mirror.cli.main import main
from mirror.dataset import Dataset
from mirror.errors import ExitCode
from mirror.methods.appearance import AppearancePolicy
from tests.builders.lanes import add_initial_points

SIZE, FRAMES, T = (16, 24), 2, 5


@pytest.fixture(scope="module")
def street(made_street: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return add_initial_points(mirror.open(shutil.copytree(made_street, tmp_path_factory.mktemp("street") / "dataset")))


@pytest.fixture(scope="module")
def model(street: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A static model after a few steps: enough to tell its appearances, red, green and blue in the images."""
    folder = tmp_path_factory.mktemp("model") / "model"
    words = ["reconstruct", str(street.root), "--split", "novel", "--out", str(folder), "--steps", "8", "--width", "48"]
    assert main([*words, "--threads", "1", "--json"]) == ExitCode.DONE
    return folder


def test_a_scene_is_generated_over_a_model_in_the_appearance_asked_for(
    street: Dataset, model: Path, models: Path, tmp_path: Path
) -> None:
    (held_out,) = street.where(split="novel", role="held_out").traversals()
    found, documents = {}, {}
    red, green = (next(name for name in street.traversals() if drive in name) for drive in (".near.", ".far."))
    for number, appearance in enumerate((red, green)):
        out = tmp_path / str(number)
        words = ["generate", "scene", str(street.root), str(models), "--background", str(model), "--size", "24x16"]
        words += ["--traversal", held_out, "--hz", "10", "--frames", str(FRAMES), "--appearance", appearance]
        assert main([*words, "--cameras", "front_wide", "--out", str(out), "--json"]) == ExitCode.DONE
        documents[appearance] = json.loads((out / "generated.json").read_text())
        found[appearance] = np.stack(
            [cv2.imread(str(out / f"frames/front_wide/{one:05d}.png"))[..., ::-1] for one in range(FRAMES)]
        )
        # The road user of this street is out of sight: each view is what the model renders, in the generator's raster.
        assert documents[appearance]["kept_views"] == FRAMES
        np.testing.assert_array_equal(found[appearance], rendered(street, model, held_out, appearance))
    assert documents[red]["inputs"]["appearance"] == red
    assert len({one["inputs"]["background"] for one in documents.values()}) == 1
    redder = {name: float((one[..., 0].astype(float) - one[..., 1]).mean()) for name, one in found.items()}
    # Measured 15 and -4 grey levels after eight steps.
    assert redder[red] > 5.0 > 0.0 > redder[green]


def rendered(street: Dataset, model: Path, traversal: str, appearance: str) -> UInt8:
    """Return what the model renders at the frames behind the seeds."""
    plan = plan_scene(street, traversal, hz=10.0, trajectory=None, references=T, count=FRAMES)
    rig = rig_of(street.where(traversal=traversal).frames(), ("front_wide",), SIZE, PIXELS)
    views = [view for one in plan.frames for view in rig.views(one.frame, one.world_SE3_ego, plan.light, plan.weather)]
    draw = open_model(model, AppearancePolicy(appearance, views, everywhere=True))
    return np.stack([cv2.resize(draw(view), SIZE[::-1], interpolation=cv2.INTER_AREA) for view in views[T:]])


def test_clips_have_the_street_in_the_appearance_of_their_recording(
    street: Dataset, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["generate", "clips", str(street.root), "--background", str(model), "--size", "24x16", "--frames", "3"]
    words += [
        "--cameras",
        "front_wide",
        "--min-share",
        "0",
        "--min-busy",
        "0",
        "--out",
        str(tmp_path / "clips"),
        "--json",
    ]
    # The masks of the points' depth are of the sky, if any: they say nothing of road users.
    assert main(words) == ExitCode.COULD_NOT_RUN
    assert "mirror annotate masks" in capsys.readouterr().out
    assert main(["annotate", "masks", str(street.root), "--json"]) == ExitCode.DONE
    capsys.readouterr()
    assert main([*words, "--split", "nothing"]) == ExitCode.COULD_NOT_RUN
    capsys.readouterr()
    assert main(words) == ExitCode.DONE
    statistics = json.loads(capsys.readouterr().out)
    (held_out,) = street.where(split="novel", role="held_out").traversals()
    clips = [read_clip(tmp_path / "clips", name) for name in read_list(tmp_path / "clips").training]
    assert held_out not in {clip.drive_id for clip in clips}
    redder = {}
    for clip in clips:
        frames = street.where(traversal=clip.drive_id).frames()
        rig = rig_of(frames, ("front_wide",), SIZE, PIXELS)
        first = next(frame for frame in frames if frame.frame_index == int(clip.clip_id.rpartition("-")[2]))
        (view,) = rig.views(first, first.world_SE3_ego, "day", "clear")
        image = first.images["front_wide"]
        placed = view.model_copy(update={"world_SE3_camera": image.world_SE3_camera})
        expected = open_model(model)(placed)
        np.testing.assert_array_equal(
            clip.background[0, 0], cv2.resize(expected, SIZE[::-1], interpolation=cv2.INTER_AREA)
        )
        redder[clip.drive_id] = float((clip.background[..., 0].astype(float) - clip.background[..., 1]).mean())
        # No road user is seen here, so that nothing hides the street.
        assert clip.hidden is not None and not clip.hidden.any()
    red, green = (next(name for name in redder if drive in name) for drive in (".near.", ".far."))
    assert redder[red] > 5.0 > 0.0 > redder[green]
    assert set(statistics["counts"]["errors"]) == {name for _, name in HIDDEN}
