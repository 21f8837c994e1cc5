"""Training with maps, and scenes whose recorded map is shown to the generator."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mirror
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.folder import ClipList, write_clip, write_list
from hybridworldsim.generation.clips.map_lines import FARTHEST_M, LINE_KINDS, MapLine
from hybridworldsim.generation.command import main
from hybridworldsim.generation.model_files import read_generator
from hybridworldsim.generation.scenes import planned_views
from hybridworldsim.generation.scenes import rollout as rollout_module
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles, open_generator
from hybridworldsim.generation.scenes.scene_clip import SceneConditions
from hybridworldsim.generation.scenes.scene_map import open_scene_map
from hybridworldsim.generation.scenes.submission import SubmissionRequest, generate_submission
from mirror.cli.main import main as mirror_main
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, ExitCode
from mirror.progress import NullProgress
from mirror.protocols.png import encode_png
from mirror.schema.files import write_bytes
from mirror.synth.writing.recordings import SynthReport
from tests.generation.clips import make_clip, write_clips

LINE = MapLine("lane", np.array([[14.0, 3.0, -1.0], [14.0, -3.0, -1.0]]))
CAMERAS = ("front_wide", "front_left")


class Messages(NullProgress):
    """Keeps the messages."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def message(self, text: str) -> None:
        self.texts.append(text)


@pytest.fixture(scope="module")
def with_map(models: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A generator after two steps on two clips, of which one has a map."""
    folder = tmp_path_factory.mktemp("with-map")
    write_clip(folder / "clips", replace(make_clip("clip-0"), lines=(LINE,)))
    write_clip(folder / "clips", make_clip("clip-1", seed=1))
    write_list(folder / "clips", ClipList(source="test", training=("clip-0", "clip-1"), test=()))
    words = ["train", str(folder / "clips"), "--map", "--steps", "2", "--batch", "1", "--json"]
    words += ["--autoencoder", str(models / "autoencoder" / "model.safetensors"), "--out", str(folder / "out")]
    assert main(words) == ExitCode.DONE
    shutil.copytree(models / "autoencoder", folder / "out" / "autoencoder")
    return folder / "out"


@pytest.fixture(scope="module")
def mapped(tiny_dataset: Dataset, tiny_recordings: SynthReport, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The dataset with the exact map of its street."""
    root = tmp_path_factory.mktemp("mapped") / "dataset"
    shutil.copytree(tiny_dataset.root, root, copy_function=os.link)
    maps = tiny_recordings.recordings[0].parent / "maps"
    assert mirror_main(["ingest", "--map", str(maps), "--out", str(root)]) == ExitCode.DONE
    return mirror.open(root)


def generate(dataset: Dataset, traversal: str, models: Path, out: Path) -> dict[str, object]:
    for frame, camera in itertools.product(dataset.where(traversal=traversal).frames()[:7], CAMERAS):
        grey = np.full((32, 48, 3), 90, np.uint8)
        write_bytes(out.parent / "grey" / camera / f"{frame.timestamp_ns}.png", encode_png(grey))
    words = ["scene", str(dataset.root), str(models), "--background", f"files:{out.parent / 'grey'}", "--size", "24x16"]
    words += ["--traversal", traversal, "--cameras", ",".join(CAMERAS), "--frames", "2", "--out", str(out)]
    assert main([*words, "--trajectory", "lane-shift:2", "--steps", "1", "--no-keep-empty-views"]) == ExitCode.DONE
    inputs: dict[str, object] = json.loads((out / "generated.json").read_text())["inputs"]
    return inputs


def test_a_generator_that_was_trained_with_a_map_gets_that_of_the_scene(
    mapped: Dataset, traversal: str, with_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    network, references = read_generator(with_map / "generator" / "model.safetensors")
    assert network.config.layout is not None and network.config.layout.channels == 7 * (references + 1)
    document = json.loads((with_map / "generator" / "run.json").read_text())
    assert document["settings"]["network"]["layout"]["channels"] == 7 * (references + 1)
    clips: list[Clip] = []
    make = rollout_module.make_scene_clip
    monkeypatch.setattr(rollout_module, "make_scene_clip", lambda *a, **k: clips.append(make(*a, **k)) or clips[-1])
    inputs = generate(mapped, traversal, with_map, tmp_path / "out")
    scene = mapped.where(traversal=traversal).scenes()[0]
    file = Path(mapped.root) / "maps" / scene / "map.parquet"
    assert inputs["map"] == hashlib.sha256(file.read_bytes()).hexdigest()
    (clip,) = clips
    assert clip.lines is not None and {line.kind for line in clip.lines} == set(LINE_KINDS)
    # Back in the scene's frame, by the recorded pose of the first seed, borders are those of the map.
    frame = mapped.where(traversal=traversal).frames()[0]
    stamps, poses = frame.track
    pose = poses[int(np.searchsorted(stamps, frame.timestamp_ns))].matrix()[0]
    road_map = mapped.road_map(scene)
    assert road_map is not None
    found = np.concatenate([line.points_m for line in clip.lines if line.kind == "drivable"])
    found = found @ pose[:3, :3].T + pose[:3, 3]
    corners = np.concatenate(road_map.drivable_rings)
    # Borders that no frame shows are left out.
    seeds = [one.timestamp_ns for one in mapped.where(traversal=traversal).frames()[:references]]
    driven = poses.translation[np.searchsorted(stamps, seeds), :2]
    corners = corners[np.linalg.norm(corners[:, None] - driven[None], axis=-1).min(axis=1) < FARTHEST_M]
    assert len(corners) > 20
    away = np.linalg.norm(corners[:, None] - found[None, :, :2], axis=-1).min(axis=1)
    assert away.max() < 0.05


def test_without_a_map_the_generator_says_so_and_gets_no_lines(
    tiny_dataset: Dataset, traversal: str, with_map: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inputs = generate(tiny_dataset, traversal, with_map, tmp_path / "out")
    assert inputs["map"] is None
    scene = tiny_dataset.where(traversal=traversal).scenes()[0]
    assert f"scene {scene} has no recorded map" in capsys.readouterr().err


def test_a_generator_that_takes_no_map_ignores_that_of_the_dataset(mapped: Dataset, models: Path) -> None:
    """No map is looked for; the inputs have no entry of one, so that scenes begun before there were maps continue."""
    files = [models / part / "model.safetensors" for part in ("generator", "autoencoder")]
    messages = Messages()
    one = open_scene_map(mapped, "no such scene", open_generator(*files), messages)
    assert (one.lines, one.inputs, messages.texts) == (None, {}, [])


def test_a_submission_has_the_map_of_each_scene(
    mapped: Dataset, with_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[object] = []

    def stop(_: object, frames: object, scene: SceneConditions, *rest: object, **more: object) -> None:
        shown.append(scene.lines)
        raise KeyboardInterrupt

    monkeypatch.setattr(planned_views, "roll_out_sequence", stop)
    files = [with_map / part / "model.safetensors" for part in ("generator", "autoencoder")]
    request = SubmissionRequest(GeneratorFiles(*files), "generation", "novel", "exact:tiny", size_px=(16, 24))
    with pytest.raises(KeyboardInterrupt):
        generate_submission(mapped, request, tmp_path / "out")
    (lines,) = shown
    assert isinstance(lines, tuple) and len(lines) > 10


def test_clips_without_a_map_are_refused_before_anything_is_trained(
    models: Path, with_map: Path, tmp_path: Path
) -> None:
    clips = write_clips(tmp_path / "clips", count=1)
    train = ["train", str(clips), "--map", "--steps", "1"]
    distil = ["distil", str(clips), str(with_map), "--steps", "1"]
    for words in (train, distil):
        with pytest.raises(DatasetError, match="no training clip has a map") as caught:
            main([*words, "--out", str(tmp_path / "out")])
        assert caught.value.file == str(clips) and caught.value.remedy
    assert not (tmp_path / "out").exists()
