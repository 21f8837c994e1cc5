"""The study from clips to the tables of the page, at a tiny size: every stage runs, resumes, and is hashed."""

from __future__ import annotations

import json
import math
import shutil
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.studies.generation import crops
from benchmarks.studies.generation.comparison import compare
from benchmarks.studies.generation.declaration import FILE, load_declaration
from benchmarks.studies.generation.edits import Edit, EditScore, normalise, plan_edits, score_edit
from benchmarks.studies.generation.features import DIMENSIONS, trunk_features
from benchmarks.studies.generation.judge_data import CROP_PX, LEAST_PX
from benchmarks.studies.generation.make_clips import (
    BUSTLE,
    CLIP_FRAMES,
    PRESET,
    TEST_FRAMES,
    TEST_SEEDS,
    TRAINING_SEEDS,
)
from benchmarks.studies.generation.published import FVD_FRAMES, STAGE, load_networks, measure_published
from benchmarks.studies.generation.report import BEGIN, END, PAGE, format_report, update_page
from benchmarks.studies.generation.rollouts import predict_next
from benchmarks.studies.generation.scoring import background_db, identity, score_clip
from benchmarks.studies.generation.sheets import write_sheets
from benchmarks.studies.generation.stages import list_stages
from benchmarks.studies.generation.study import Study, run_stages
from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.clips.folder import ClipList, write_clip, write_list
from hybridworldsim.generation.training.autoencoder_trainer import AutoencoderSettings
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
from mirror.arrays import Float64, UInt8
from mirror.errors import DatasetError, UsageError
from mirror.metrics.features.frechet import frechet_distance
from mirror.metrics.features.st_lpips import st_lpips_trunk
from mirror.metrics.features.statistics import FeatureStatistics
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import load_protocol
from mirror.weights.errors import WeightsUnavailableError
from tests.generation.trained import CODEC, NETWORK, T

WIDTH, HEIGHT, FOCAL = 48, 32, 40.0
DRIVES = 4


def make_street_clip(clip_id: str, seed: int, frames: int) -> Clip:
    """A car ahead of one camera of two, at 5 m; the image differs from the background exactly where its box is."""
    rng = np.random.default_rng(seed)
    background = np.repeat(rng.integers(60, 200, (1, 2, HEIGHT, WIDTH, 3), np.uint8), frames, axis=0)
    images, tracks = background.copy(), np.full((frames, 2, HEIGHT, WIDTH), -1, np.int16)
    # 2 m wide and 1.5 m high at 4 m: the near side of a box of 2 m length.
    images[:, 0, 9:24, 14:34] = rng.integers(0, 40, 3, np.uint8)
    tracks[:, 0, 9:24, 14:34] = 7
    mounts = np.tile(np.eye(4), (2, 1, 1))
    mounts[0, :3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    mounts[1, :3, :3] = [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    lens = np.array([[FOCAL, 0.0, WIDTH / 2], [0.0, FOCAL, HEIGHT / 2], [0.0, 0.0, 1.0]])
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 0, 3] = 5.0
    numbers = np.arange(frames, dtype=np.int64)
    boxes = ClipBoxes(
        numbers, np.full(frames, 7), np.full(frames, seed % 2), poses, np.tile((2.0, 2.0, 1.5), (frames, 1))
    )
    return Clip(
        clip_id, f"drive-{seed}", 5.0, ("front", "rear"), images, background, np.ones((frames, 2), bool),
        np.tile(lens, (2, 1, 1)), mounts, np.tile(np.eye(4), (frames, 1, 1)), boxes, tracks,
    )  # fmt: skip


def make_clips(folder: Path, progress: ProgressReporter) -> None:
    names: dict[bool, list[str]] = {True: [], False: []}
    for seed in range(2 * DRIVES):
        test = seed < DRIVES
        names[test].append(f"clip-{seed}")
        write_clip(folder, make_street_clip(f"clip-{seed}", seed, 12 if test else 6))
    write_list(folder, ClipList(source="test", training=tuple(names[False]), test=tuple(names[True])))


def features(images: UInt8) -> Float64:
    """A fixed random projection: no published network."""
    rng = np.random.default_rng(5)
    small = images.reshape(len(images), -1)[:, :: max(images[0].size // 300, 1)] / 255.0 if len(images) else None
    return np.zeros((0, DIMENSIONS)) if small is None else small @ rng.normal(size=(small.shape[1], DIMENSIONS))


def tiny_declaration(folder: Path, **changes: Any) -> Path:
    document = tomllib.loads(FILE.read_text())
    document["clips"] |= {"least_training_clips": 2, "least_test_drives": 2}
    document["training"] |= {"steps": 3, "autoencoder_steps": 3, "seeds": [0, 1]}
    document["distillation"] |= {
        "teacher_steps": [1, 2],
        "teacher_frames": 6,
        "steps": 2,
        "segments": 2,
        "small_steps": 4,
    }
    document["scoring"] |= {"sampler_steps": 1, "resamples": 5, "edits_m": [2.0, 3.0], "edit_frames": 2, "mask_px": 20}
    document["scoring"] |= {"nearest_m": 3.0}
    document["bars"] |= changes
    lines = []
    for table, values in document.items():
        lines += [f"[{table}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
    path = folder / "experiment.toml"
    path.write_text("\n".join(lines))
    return path


def make_study(folder: Path, **bars: float) -> Study:
    folder.mkdir(parents=True, exist_ok=True)
    return Study(
        folder / "study",
        load_declaration(tiny_declaration(folder, **bars)),
        make_clips,
        network=GeneratorSettings(NETWORK, T, batch=2, warmup=1),
        autoencoder_settings=AutoencoderSettings(CODEC, batch=2, warmup=1),
        load=lambda: features,
        judge_steps={"segmenter": 2, "classifier": 2},
        published=folder / "outcomes.jsonl",
    )


def run_all(study: Study, *, only: str | None = None, hours: float | None = None) -> int:
    return run_stages(study, list_stages(study.declaration), NullProgress(), only=only, hours=hours)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A study whose off model counts as good enough, whatever it learned."""
    made = make_study(tmp_path_factory.mktemp("study"), off_background_db=0.0)
    assert run_all(made) == 0
    return made


def test_declaration_is_that_of_the_clips_and_fits_the_budget() -> None:
    declaration = load_declaration()
    clips = declaration.clips
    assert (clips["preset"], clips["bustle"]) == (PRESET, BUSTLE)
    assert (tuple(clips["training_seeds"]), tuple(clips["test_seeds"])) == (TRAINING_SEEDS, TEST_SEEDS)
    assert (clips["frames"], clips["test_frames"]) == (CLIP_FRAMES, TEST_FRAMES)
    vehicles = load_protocol("editing-accuracy-small").vehicles
    assert vehicles is not None and declaration.scoring["mask_px"] == vehicles.min_area_px == LEAST_PX
    stages = list_stages(declaration)
    assert sum(stage.core_minutes for stage in stages) <= 60.0 * declaration.budget["core_hours"]
    # At most one core-hour a model; three seeds for conditioning on and off alone.
    trained = [stage.name for stage in stages if stage.name.startswith("train-")]
    assert sorted(trained) == ["train-noise", *(f"train-{kind}-{seed}" for kind in ("off", "on") for seed in range(3))]


def test_every_stage_leaves_figures_and_the_report_has_every_bar(study: Study) -> None:
    text = format_report(study)
    assert "not run" not in text.lower()
    assert text[: text.index("| seed |")].count("\n| ") == 1 + 15
    for stage in list_stages(study.declaration):
        assert study.figures(stage.name) is not None
    own = study.figures("score-on-0")
    assert own is not None and np.isfinite([own["db"], own["iou"], own["classified"]]).all()
    off = study.figures("score-off-0")
    # The street of these clips stands still: a copy of the frame before is exact.
    assert off is not None and np.isfinite(off["next_db"]) and off["before_db"] == float("inf")
    truth = study.figures("truth")
    assert truth is not None and truth["db"] == float("inf") and truth["correlation"] == pytest.approx(1.0)


def test_next_frames_are_those_of_rollouts_that_begin_there(study: Study) -> None:
    clip, model = study.test[0], study.model("on-0")
    made = predict_next(model, study.autoencoder, [clip], [T, T + 3], 1)[clip.clip_id]
    with np.load(study.folder / "rollouts" / "on-0" / f"{clip.clip_id}.npz") as stored:
        assert (made[0] == stored["images"][0]).all()
        # Later frames of a rollout follow its own output.
        assert (made[1] != stored["images"][3]).any()


def test_finished_stages_are_not_run_again(study: Study) -> None:
    before = {file: file.stat().st_mtime_ns for file in sorted(study.folder.rglob("*")) if file.is_file()}
    assert run_all(study) == 0
    assert {file: file.stat().st_mtime_ns for file in sorted(study.folder.rglob("*")) if file.is_file()} == before


def test_one_stage_and_the_budget(tmp_path: Path) -> None:
    made = make_study(tmp_path)
    stages = len(list_stages(made.declaration))
    assert run_all(made, hours=0.1) == stages
    assert run_all(made, only="clips") == stages - 1
    assert (made.figures("clips") or {})["test_drives"] == DRIVES
    assert made.used_core_s() < 60.0
    with pytest.raises(UsageError, match="no stage"):
        run_all(made, only="clip")


def test_missing_weights_are_named_before_the_first_stage(tmp_path: Path) -> None:
    def load() -> Any:
        raise UsageError("weights are missing")

    made = replace(make_study(tmp_path), load=load)
    with pytest.raises(UsageError, match="weights are missing"):
        run_all(made)
    assert not (made.folder / "clips").exists()


def test_published_outcomes_are_shown_without_the_folder(study: Study, tmp_path: Path) -> None:
    text = format_report(study)
    published = replace(study, published=tmp_path / "outcomes.jsonl").publish()
    elsewhere = replace(study, folder=tmp_path / "empty", published=published)
    assert format_report(elsewhere) == text
    # The true images have no error, which strict JSON cannot state.
    assert (study.figures("truth") or {})["db"] == math.inf
    rows = [json.loads(line, parse_constant=pytest.fail) for line in published.read_text().splitlines()]
    assert next(row for row in rows if row["stage"] == "truth")["figures"]["db"] is None
    assert math.isnan(elsewhere.outcomes["truth"].figures["db"])
    # They are no reason to leave a stage out, since later stages need its files.
    assert elsewhere.figures("clips") is None and elsewhere.used_core_s() == 0.0
    other = replace(elsewhere, declaration=replace(study.declaration, hash="0" * 64))
    assert other.outcomes == {}


def test_another_declaration_is_refused(study: Study) -> None:
    other = replace(study, declaration=replace(study.declaration, hash="0" * 64))
    with pytest.raises(UsageError, match="made under the declaration"):
        run_all(other)


def test_comparison_is_void_if_the_off_model_copies_too_little(study: Study) -> None:
    bars = {**study.declaration.bars, "off_background_db": 99.0}
    void = replace(study, declaration=replace(study.declaration, bars=bars))
    assert void.is_void() and not study.is_void()
    assert format_report(void).count("| void |") == 2


def test_page_has_markers_and_gets_the_section(study: Study, tmp_path: Path) -> None:
    assert BEGIN in PAGE.read_text() and END in PAGE.read_text()
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    update_page(study, page)
    assert page.read_text() == f"before\n{format_report(study)}\nafter\n"
    page.write_text("nothing")
    with pytest.raises(UsageError, match="no place"):
        update_page(study, page)


def test_fid_and_fvd_are_shown_where_their_weights_are(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Mean:
        """Mean colours instead of a network's features."""

        name, mode, crop, identity, batch, computed, frames = "smoke", "clean", "direct224", "smoke", 8, 0, None
        weights: Mapping[str, str] = MappingProxyType({})

        def prepare(self, pixels: Any) -> torch.Tensor:
            return torch.from_numpy(pixels.reshape(-1, pixels.shape[-1]).mean(0) / 255.0)

        def run(self, prepared: torch.Tensor) -> Any:
            return prepared.float().numpy()

        def check(self, clip: Any) -> None:
            assert len(clip) == FVD_FRAMES

    network: Any = Mean()
    other = replace(study, folder=tmp_path / "study")
    shutil.copytree(study.folder, other.folder)
    figures = measure_published(other, network, None)
    assert {"background", "on-0", "off-1", "distilled"} <= set(figures)
    truth = np.concatenate([clip.images[T:, 0].reshape(len(clip) - T, -1, 3).mean(1) for clip in other.test]) / 255.0
    empty = np.concatenate([clip.background[T:, 0].reshape(len(clip) - T, -1, 3).mean(1) for clip in other.test])
    expected = frechet_distance(empty / 255.0, truth).value
    assert figures["background"]["fid"] == pytest.approx(expected, rel=1e-4)
    other.finish(STAGE, 1.0, figures)
    assert "| background: FID and FVD | - | FID " in format_report(other)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.delenv("MIRROR_WEIGHTS", raising=False)
    with pytest.raises(WeightsUnavailableError):
        load_networks()


def test_crops_are_compared_by_class_and_drive(study: Study, tmp_path: Path) -> None:
    other = replace(study, folder=tmp_path / "study")
    shutil.copytree(study.folder, other.folder)
    figures = crops.measure_crops(other, least_crops=1)
    own = figures["on-0"]
    assert own["all"] == pytest.approx((other.figures("vehicles") or {})["value"])
    assert set(own["classes"]) == {"car", "van"} and set(own["drives"]) == {f"drive-{seed}" for seed in range(DRIVES)}
    parts = {}
    for name in ("truth", "background", "on-0"):
        # Clips of even seeds show a car, the others a van.
        files = [np.load(other.folder / "scores" / name / f"clip-{seed}.npz") for seed in range(0, DRIVES, 2)]
        parts[name] = np.concatenate([file["crop"] for file in files])
    expected = [frechet_distance(parts[name], parts["truth"]).value for name in ("on-0", "background")]
    assert own["classes"]["car"] == pytest.approx(expected[0] / expected[1])
    assert crops.measure_crops(other, least_crops=10_000)["on-0"]["classes"] == {}
    other.finish(crops.STAGE, 1.0, figures)
    row = next(line for line in format_report(other).splitlines() if line.startswith("| on-0 |"))
    worst = sorted(own["drives"].values())[-2:]
    values = [own["all"], own["classes"]["car"], own["classes"]["van"], worst[1], worst[0]]
    assert row == f"| on-0 | {' | '.join(f'{value:.2f}' for value in values)} |"


def test_models_of_other_seeds_stand_beside_the_first(study: Study) -> None:
    seeds = study.declaration.training["seeds"]
    lines = format_report(study).splitlines()
    place = next(number for number, line in enumerate(lines) if line.startswith("| seed | background, dB |"))
    rows = [line.split("|")[1:-1] for line in lines[place + 2 : place + 2 + len(seeds)]]
    for seed, row in zip(seeds, rows, strict=True):
        score = study.figures(f"score-on-{seed}") or {}
        assert [row[0].strip(), row[1].strip(), row[2].strip()] == [
            str(seed),
            f"{score['db']:.2f}",
            f"{score['iou']:.3f}",
        ]


def test_sheets_show_truth_background_and_models(study: Study, tmp_path: Path) -> None:
    import cv2

    paths = write_sheets(study, tmp_path)
    assert len(paths) == DRIVES
    sheet = cv2.imread(str(paths[0]))
    sources = 2 + len([path for path in (study.folder / "rollouts").iterdir() if not path.name.startswith("teacher-")])
    # Each image has its own size, under a caption of 16 pixels, with gaps of 4, and the name of its row to the left.
    assert sheet.shape == (sources * 2 * (HEIGHT + 20), 144 + 8 * (WIDTH + 4), 3)
    assert (sheet[16 : 16 + HEIGHT, 144 : 144 + WIDTH, ::-1] == study.test[0].images[T, 0]).all()


def test_too_few_clips_are_refused(tmp_path: Path) -> None:
    made = make_study(tmp_path)
    strict = replace(
        made, declaration=replace(made.declaration, clips={**made.declaration.clips, "least_test_drives": 99})
    )
    with pytest.raises(DatasetError, match="4 of 99"):
        run_all(strict, only="clips")


def test_features_of_the_trunk_have_few_dimensions() -> None:
    found = trunk_features(st_lpips_trunk("alex").eval())
    for size in ((64, 96), (CROP_PX, CROP_PX)):
        images = np.random.default_rng(0).integers(0, 256, (70, *size, 3), np.uint8)
        rows = found(images)
        assert rows.shape == (70, DIMENSIONS) and np.isfinite(rows).all()
        # A row depends on its image alone, not on the batch.
        assert rows[65:] == pytest.approx(found(images[65:]), rel=1e-4, abs=1e-6)


def test_scores_of_the_truth_and_of_the_background() -> None:
    clip = make_street_clip("clip", 0, 9)
    truth, copy = (score_clip(clip, T, images[T:], features, None) for images in (clip.images, clip.background))
    assert len(truth["image"]) == len(clip) - T and len(truth["motion"]) == len(clip) - T - 1
    # The background is exact outside the masks, and both crops of a box differ.
    assert background_db([copy])["db"] == float("inf")
    assert (truth["own"] == truth["true"]).all() and (copy["own"] != copy["true"]).all()
    assert np.abs(truth["crop"] - copy["crop"]).max() > 0.01
    noisy = clip.images[T:].astype(int)
    noisy[5:] += 10
    one = score_clip(clip, T, noisy.clip(0, 255).astype(np.uint8), features, None)
    assert background_db([one])["db"] == pytest.approx(-10 * np.log10((10 / 255) ** 2 * 2 / 7), abs=1e-9)


def test_identity_falls_where_brightness_is_lost() -> None:
    rng = np.random.default_rng(0)
    track, frame = np.repeat(np.arange(40), 60), np.tile(np.arange(60), 40)
    true = np.repeat(rng.uniform(20, 200, 40), 60)
    kept = {"track": track, "frame": frame, "own": true + rng.normal(0, 2, len(true)), "true": true, "seen": track < 20}
    lost = {**kept, "own": np.where(frame < 25, kept["own"], rng.uniform(20, 200, len(true)))}
    assert identity([kept], 50, 20)["kept"] == pytest.approx(1.0, abs=0.01)
    assert identity([kept], 50, 20)["correlation"] > 0.99
    assert identity([lost], 50, 20)["kept"] < 0.3
    assert identity([kept], 50, 20)["horizon_frames"] == 50
    # Road users that no seed shows have another brightness: those that one shows are counted apart.
    guessed = {**kept, "own": np.where(kept["seen"], kept["own"], rng.permutation(true))}
    assert identity([guessed], 50, 20)["correlation"] < 0.7 < 0.99 < identity([guessed], 50, 20)["seen_correlation"]
    # Fewer than twenty tracks are long: the longest horizon that twenty have.
    short = {name: values[(track < 5) | (frame < 30)] for name, values in kept.items()}
    assert identity([short], 50, 20)["horizon_frames"] == 30


def test_ratio_of_distances_and_its_interval() -> None:
    rng = np.random.default_rng(1)

    def drives(scale: float) -> dict[str, Float64]:
        return {f"d{number}": rng.normal(scale, 1.0, (60, 3)) for number in range(6)}

    truth, near, far = drives(0.0), drives(1.0), drives(2.0)
    statistics = [{d: FeatureStatistics.from_features(x) for d, x in one.items()} for one in (near, far, truth)]
    found = compare([statistics[0]], [statistics[1]], statistics[2], resamples=200, level=0.95)
    whole = [np.concatenate(list(one.values())) for one in (near, far, truth)]
    expected = [frechet_distance(one, whole[2]).value for one in whole[:2]]
    assert found.distances == pytest.approx(expected, rel=1e-9)
    assert found.value == pytest.approx(expected[0] / expected[1], rel=1e-9)
    assert found.low < found.value < found.high < 0.5
    same = compare([statistics[0]], [statistics[0]], statistics[2], resamples=20, level=0.95)
    assert (same.value, same.low, same.high) == pytest.approx((1.0, 1.0, 1.0))


class _Differs:
    """A perfect segmenter of clips whose images equal their background elsewhere."""

    def __call__(self, images: Any, backgrounds: Any) -> Any:
        return 2.0 * (images != backgrounds).any(dim=1).float() - 1.0


def test_edits_are_scored_between_ignored_and_followed() -> None:
    clip = make_street_clip("clip", 0, 9)
    (edit,) = plan_edits([clip], T, 3, 2, 1.0, 20, 3.0)
    assert (edit.track, len(edit.clip)) == (7, T + 3)
    # The seeds do not show the vehicle unmoved, and have no box where it was.
    assert (edit.clip.images[:T] == edit.clip.background[:T]).all()
    assert edit.clip.boxes.frame.tolist() == [T, T + 1, T + 2]
    ignored = edit.clip.images[T:]
    followed = edit.clip.background[T:].copy()
    followed[:, 0, 9:24, 4:24] = 0
    segmenter: Any = _Differs()
    low = normalise(score_edit(edit, ignored, segmenter, 20))
    high = normalise(score_edit(edit, followed, segmenter, 20))
    assert low["normalised"] == pytest.approx(0.0) and low["ceiling"] > 0.8
    assert high["normalised"] == pytest.approx(1.0, abs=0.1)
    # Nothing comes nearer than it may.
    assert plan_edits([clip], T, 3, 2, 1.0, 20, 6.0) == []
    assert normalise([EditScore(0.5, 0.2, 0.8)])["normalised"] == pytest.approx(0.5)
    assert isinstance(edit, Edit)
