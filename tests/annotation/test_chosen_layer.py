"""With several layers of boxes, generation and simulation read the one that is named, and refuse to choose."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import mirror
from hybridworldsim.generation.scenes.plan import plan_scene
from hybridworldsim.generation.scenes.rig import rig_of
from hybridworldsim.generation.scenes.run import PIXELS
from hybridworldsim.generation.scenes.scene_clip import SceneConditions, make_scene_clip
from hybridworldsim.simulator.street.of_dataset import street_of_dataset
from mirror.annotation import annotate
from mirror.annotation.box_layer import box_layers, with_box_layer
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from tests.annotation.known import Known

SIZES = {(4.2, 1.8, 1.5), (0.7, 0.6, 1.7)}


@pytest.fixture(scope="module")
def two_layers(tiny_dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny street with its own boxes, and those of `Known` beside them."""
    root = tmp_path_factory.mktemp("layers") / "dataset"
    shutil.copytree(tiny_dataset.root, root)
    annotate(mirror.open(root), Known())
    assert len(box_layers(mirror.open(root))) == 2
    return root


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "DATASET", "--scenario", "free-traffic", "--policy", "stop"],
        ["generate", "scene", "DATASET", "generator", "--background", "exact:tiny"],
    ],
)
@pytest.mark.parametrize("chosen", [[], ["--boxes", "nobody@1"]])
def test_a_layer_has_to_be_named(
    two_layers: Path, tmp_path: Path, words: list[str], chosen: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    command = [str(two_layers) if word == "DATASET" else word for word in words]
    assert main([*command, *chosen, "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert "--boxes" in message and all(name in message for name in box_layers(mirror.open(two_layers)))
    assert not (tmp_path / "out").exists()


def test_recorded_road_users_of_a_street_are_those_of_the_layer(two_layers: Path, tiny_dataset: Dataset) -> None:
    dataset = mirror.open(two_layers)
    known = street_of_dataset(dataset, boxes="known@1")
    found = {track.agent.size_m for one in known.recordings.values() for track in one.tracks}
    assert found == SIZES
    (own,) = (name for name in box_layers(dataset) if name != "known@1")
    before, after = street_of_dataset(tiny_dataset), street_of_dataset(dataset, boxes=own)
    for name, recording in before.recordings.items():
        assert [one.agent for one in recording.tracks] == [one.agent for one in after.recordings[name].tracks]


def test_a_generated_scene_has_the_boxes_of_the_layer(two_layers: Path) -> None:
    dataset = with_box_layer(mirror.open(two_layers), "known@1")
    traversal = dataset.traversals()[0]
    plan = plan_scene(dataset, traversal, hz=None, trajectory=None, references=5, count=3)
    rig = rig_of(dataset.where(traversal=traversal).frames(), ("front_wide",), (16, 24), PIXELS)
    scene = SceneConditions(
        rig, lambda view: np.zeros((view.height_px, view.width_px, 3), np.uint8), plan.rate_hz, plan.light,
        plan.weather, plan.tracks,
    )  # fmt: skip
    clip = make_scene_clip("c", plan.frames, scene, recorded=5)
    assert {tuple(size) for size in clip.boxes.lwh_m.round(6).tolist()} == SIZES


def test_a_dataset_without_boxes_is_read_as_it_is(root: Path) -> None:
    dataset = mirror.open(root)
    assert with_box_layer(dataset, None).layers.boxes is None
    with pytest.raises(UsageError, match="no layer of boxes 'human@1'"):
        with_box_layer(dataset, "human@1")
