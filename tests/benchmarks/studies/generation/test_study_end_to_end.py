"""The addition to the study: roads are recorded, backgrounds rendered where the clips are, and losses stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from benchmarks.studies.generation.backgrounds import render_backgrounds
from benchmarks.studies.generation.declaration import load_declaration
from benchmarks.studies.generation.end_to_end import list_parts, list_roads, load_addition, open_addition
from benchmarks.studies.generation.end_to_end_table import format_addition
from benchmarks.studies.generation.features import DIMENSIONS
from benchmarks.studies.generation.make_clips import ROUTES, TRAINING_SEEDS
from benchmarks.studies.generation.report import format_report
from benchmarks.studies.generation.road_models import Road, RoadModel
from benchmarks.studies.generation.stages import list_stages
from benchmarks.studies.generation.street_clips import VIEWS, StreetRecorder, StreetRig
from benchmarks.studies.generation.study import Figures, Study, run_stages
from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.clips.folder import ClipList, write_clip, write_list
from hybridworldsim.generation.model_files import write_autoencoder, write_generator
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
from mirror.arrays import Float64, UInt8
from mirror.errors import DatasetError, UsageError
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.views.view import RenderView
from mirror.synth.render.lens import make_lens
from tests.generation.trained import CODEC, NETWORK, T

ROUTE, SEED, FIRST = "guangzhou-urban-01", 3, 40
RECORDINGS = {"seeds": [SEED], "spacing_m": 4.0, "width_px": 96, "height_px": 64}
ROAD = Road("road", (ROUTE,), 9.0, RECORDINGS, {}, 2, preset="tiny", bustle=0.3)


@pytest.fixture(scope="module")
def recorder() -> StreetRecorder:
    """A drive through a small synthetic street."""
    return StreetRecorder(RoadModel(ROAD, Path()).drive(f"{ROUTE}-s{SEED}"), StreetRig())


@pytest.fixture(scope="module")
def clip(recorder: StreetRecorder) -> Clip:
    """Two frames of it, half a second apart, as a clip at 2 Hz."""
    made = recorder.record(f"{ROUTE}-s{SEED}-{FIRST:03d}", FIRST / 2.0 + np.array([0.0, 0.5]))
    return replace(made, rate_hz=2.0)


def difference_db(image: UInt8, other: UInt8) -> float:
    return float(-10.0 * np.log10(np.mean((image.astype(float) - other) ** 2) / 255.0**2))


def test_backgrounds_are_those_of_the_clip_where_the_model_is_the_exact_street(
    recorder: StreetRecorder, clip: Clip, tmp_path: Path
) -> None:
    empty = recorder.empty

    def render(view: RenderView) -> UInt8:
        instant = empty.around(FIRST / 2.0 + view.timestamp_ns * 1e-9, view.pose.translation[0])
        return empty.render(instant, make_lens(view.lens), view.pose).bgr[..., ::-1]

    poses = RoadModel(ROAD, tmp_path).world_SE3_ego(clip)
    made = render_backgrounds(clip, poses, render, traversal_id="t", scene_id="road", factor=2)
    assert made.shape == clip.background.shape
    found = [
        [difference_db(made[frame, view], clip.background[other]) for other in np.ndindex(2, 3)]
        for frame, view in np.ndindex(2, 3)
    ]
    own = np.diag(found)
    assert own.min() > 33.0
    # The view of another camera, or of the other frame, is farther away.
    assert (np.array(found) + 6.0 * (1 - np.eye(6)) <= own[:, None]).all()
    with pytest.raises(DatasetError, match=r"poses of 2 frames"):
        render_backgrounds(clip, poses[np.array([1, 0])], render, traversal_id="t", scene_id="road", factor=2)


def test_a_road_is_recorded_at_its_true_poses(recorder: StreetRecorder, tmp_path: Path) -> None:
    road = RoadModel(ROAD, tmp_path)
    assert road.record() == {"traversals": 1, "frames": 3}
    drive, rig, shown = recorder.drive, StreetRig(), 0
    for frame in road.dataset.frames():
        stamp = np.array([frame.timestamp_ns])
        ego = drive.world_SE3_ego(stamp)
        truth = list(recorder.with_traffic(float(drive.seconds(stamp)[0]), ego))
        assert list(frame.images) == sorted(VIEWS, key=list(frame.images).index)
        for camera, image in frame.images.items():
            view = VIEWS.index(camera)
            stored = cv2.imdecode(np.frombuffer(image.read(), np.uint8), cv2.IMREAD_COLOR)
            assert stored is not None
            assert difference_db(stored.astype(np.uint8), truth[view].bgr) > 30.0
            mounting = image.calibration.ego_SE3_camera.matrix()[0]
            np.testing.assert_allclose(mounting, rig.ego_SE3_camera[view], atol=1e-9)
            assert image.camera_model == rig.camera
        shown += len(np.unique(np.stack([one.view.object for one in truth]))) - 1
    assert road.dataset.count("boxes") > 0.5 * shown > 0
    # Images are apart by the declared distance.
    places = drive.world_SE3_ego(np.array([frame.timestamp_ns for frame in road.dataset.frames()])).translation
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=1), 4.0, atol=0.8)
    # A finished recording is kept.
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.*")}
    assert road.record()["frames"] == 3
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.*")} == before


def test_the_declaration_is_an_addition_to_the_experiment() -> None:
    addition, experiment = load_addition(), load_declaration()
    assert addition.experiment == experiment.hash
    assert addition.model == f"on-{experiment.training['seeds'][0]}"
    roads = list_roads(addition, Path())
    assert sorted(route for one in roads for route in one.road.routes) == sorted(ROUTES)
    # No test drive is reconstructed from.
    assert set(addition.recordings["seeds"]) <= set(TRAINING_SEEDS)
    study = make_study(Path("nowhere"))
    assert sum(one.core_minutes for one in list_parts(study, addition, roads)) <= addition.budget["core_minutes"] <= 100
    with pytest.raises(UsageError, match="addition to the experiment"):
        open_addition(study, replace(addition, experiment="0" * 64))


class Painted:
    """A road whose reconstruction is the exact background, brighter by some steps."""

    def __init__(self, route: str, brighter: int) -> None:
        self.road, self.brighter = replace(ROAD, routes=(route,)), brighter

    def record(self) -> Figures:
        return {}

    def reconstruct(self) -> Figures:
        return {"training_core_s": 60.0, "blocks": 1, "psnr_db": 30.0, "model_bytes": 1}

    def render(self, clip: Clip) -> UInt8:
        return clip.background + np.uint8(self.brighter)


def make_study_clip(clip_id: str, seed: int) -> Clip:
    """A car 4 m ahead of one of two cameras; images differ from the background exactly where its box is."""
    rng = np.random.default_rng(seed)
    frames, height, width = 8, 32, 48
    background = np.repeat(rng.integers(60, 200, (1, 2, height, width, 3), np.uint8), frames, axis=0)
    images, tracks = background.copy(), np.full((frames, 2, height, width), -1, np.int16)
    images[:, 0, 9:24, 14:34], tracks[:, 0, 9:24, 14:34] = rng.integers(0, 40, 3, np.uint8), 7
    mounts = np.tile(np.eye(4), (2, 1, 1))
    mounts[:, :3, :3] = (
        [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
        [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
    )
    lens = np.array([[40.0, 0.0, width / 2], [0.0, 40.0, height / 2], [0.0, 0.0, 1.0]])
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 0, 3] = 5.0
    boxes = ClipBoxes(
        np.arange(frames), np.full(frames, 7), np.zeros(frames, np.int64), poses, np.tile((2.0, 2.0, 1.5), (frames, 1))
    )
    return Clip(
        clip_id, f"route-s{seed}", 5.0, ("front", "rear"), images, background, np.ones((frames, 2), bool),
        np.tile(lens, (2, 1, 1)), mounts, np.tile(np.eye(4), (frames, 1, 1)), boxes, tracks,
    )  # fmt: skip


def make_clips(folder: Path, progress: ProgressReporter) -> None:
    names = [f"clip-{seed}" for seed in range(4)]
    for seed, name in enumerate(names):
        write_clip(folder, make_study_clip(name, seed))
    write_list(folder, ClipList(source="test", training=tuple(names[2:]), test=tuple(names[:2])))


def features(images: UInt8) -> Float64:
    """A fixed random projection: no published network."""
    rows = images.reshape(len(images), -1)[:, :: max(images[0].size // 300, 1)] / 255.0
    return np.asarray(rows @ np.random.default_rng(5).normal(size=(rows.shape[1], DIMENSIONS)))


def make_study(folder: Path) -> Study:
    declared = load_declaration()
    scoring = {
        **declared.scoring,
        "sampler_steps": 1,
        "resamples": 5,
        "edit_frames": 2,
        "mask_px": 20,
        "nearest_m": 3.0,
    }
    clips = {**declared.clips, "least_training_clips": 2, "least_test_drives": 2}
    return Study(
        folder,
        replace(declared, scoring=scoring, clips=clips),
        make_clips,
        network=GeneratorSettings(NETWORK, T),
        load=lambda: features,
        judge_steps={"segmenter": 1, "classifier": 1},
        published=folder / "outcomes.jsonl",
    )


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A study with untrained models, as far as the addition needs it."""
    made = make_study(tmp_path_factory.mktemp("study"))
    torch.manual_seed(0)
    network = Transformer(NETWORK)
    with torch.no_grad():
        # Adapters begin at zero, and would leave the background out.
        for parameter in network.parameters():
            parameter.copy_(0.3 * torch.randn_like(parameter))
    write_generator(made.model("on-0"), network, T)
    write_autoencoder(made.autoencoder, TinyAutoencoder(CODEC))
    for stage in ("clips", "judges", "truth", "background", "score-on-0", "edits"):
        run_stages(made, list_stages(made.declaration), NullProgress(), only=stage)
    return made


def run_addition(study: Study, folder: Path, brighter: int) -> Study:
    addition = load_addition()
    over = replace(open_addition(study, addition, folder / "published.jsonl"), folder=folder)
    parts = list_parts(study, addition, [Painted("route", brighter)])
    assert run_stages(over, parts, NullProgress()) == 0
    return over


def test_nothing_is_lost_over_backgrounds_that_are_exact(study: Study, tmp_path: Path) -> None:
    over = run_addition(study, tmp_path / "added", 0)
    for stage in ("background", "score-on-0", "edits"):
        np.testing.assert_equal(over.figures(stage), study.figures(stage))
    losses = [
        line.split(" | ")[4].removesuffix(" |") for line in format_addition(study, over) if line.startswith("| ")
    ][1:]
    assert len(losses) == 11
    assert set(losses) <= {"+0", "x 1.00", "+nan"}
    # The rollouts are its own, and it is shown in the place of the cut.
    assert sorted(path.name for path in (over.folder / "rollouts" / "on-0").iterdir()) == ["clip-0.npz", "clip-1.npz"]
    assert "Cut: end_to_end" in format_report(study) and "Cut: control" in format_report(study, over)
    elsewhere = replace(over, folder=tmp_path / "empty", published=over.publish())
    assert format_addition(study, elsewhere) == format_addition(study, over)
    before = {path: path.stat().st_mtime_ns for path in over.folder.rglob("*.*")}
    run_addition(study, over.folder, 0)
    assert {path: path.stat().st_mtime_ns for path in over.folder.rglob("*.*")} == before


def test_a_brighter_background_is_stated(study: Study, tmp_path: Path) -> None:
    over = run_addition(study, tmp_path / "added", 10)
    rendered, empty = over.figures("render"), over.figures("background")
    assert rendered is not None and empty is not None
    assert rendered["shift"] == [10.0, 10.0, 10.0]
    assert rendered["db"] == empty["db"] == pytest.approx(-20.0 * np.log10(10.0 / 255.0))
    assert [one for one in format_addition(study, over) if "+10.0, +10.0, +10.0 of 255 steps" in one]
    # What is generated depends on the background that it is generated over.
    made, before = over.figures("score-on-0"), study.figures("score-on-0")
    assert made is not None and before is not None and made["db"] != before["db"]
    # The truth is that of the recorded images: floor and ceiling of edits are those over exact backgrounds.
    edits, exact = over.figures("edits"), study.figures("edits")
    assert edits is not None and exact is not None
    for metres in exact:
        assert edits[metres]["edits"] == exact[metres]["edits"]
        assert edits[metres].get("ceiling") == exact[metres].get("ceiling")
