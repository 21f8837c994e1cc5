"""Generated scenes over a street that `mirror reconstruct` learned, in each of its appearances."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from hybridworldsim.generation.scenes.plan import plan_scene
from hybridworldsim.generation.scenes.rig import rig_of
from hybridworldsim.generation.scenes.run import PIXELS
from hybridworldsim.methods.street import open_model
from mirror.arrays import UInt8
from mirror.cli.main import main
from mirror.dataset import Dataset
from mirror.errors import ExitCode
from mirror.methods.appearance import AppearancePolicy
from tests.baselines.conftest import (
    initialise,
    made_street,  # noqa: F401 - a fixture
)

SIZE, FRAMES, T = (16, 24), 2, 5


@pytest.fixture(scope="module")
def street(made_street: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:  # noqa: F811
    return initialise(mirror.open(shutil.copytree(made_street, tmp_path_factory.mktemp("street") / "dataset")))


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
