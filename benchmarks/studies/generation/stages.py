"""The stages of the study in their order, and what each does. Trainings and rollouts continue where they stopped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Final

import numpy as np

from benchmarks.studies.generation.comparison import Ratio, Statistics, collect_statistics, compare, measure_distance
from benchmarks.studies.generation.declaration import Declaration
from benchmarks.studies.generation.edits import Edit, generate_edits, normalise, plan_edits, score_edit
from benchmarks.studies.generation.rollouts import predict_next, roll_out_all, shorten
from benchmarks.studies.generation.score_files import EMPTY, TRUTH, read_scores, write_scores
from benchmarks.studies.generation.scoring import outside_db, score_background, score_clip
from benchmarks.studies.generation.study import Figures, Stage, Study
from benchmarks.studies.generation.train_judges import load_judges, train_judges
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.folder import read_list
from hybridworldsim.generation.training.distillation import DistillationSettings
from hybridworldsim.generation.training.distillation_run import DistillationOptions, distil_on_clips
from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips, without_background
from mirror.errors import DatasetError, UsageError
from mirror.progress import ProgressReporter

_NEXT_EVERY: Final = 5
"""Of so many frames, one is generated from recorded ones, for the rule that makes a comparison void."""


def list_stages(declaration: Declaration) -> list[Stage]:
    """List all stages, those first that most bars need."""
    seeds = [int(seed) for seed in declaration.training["seeds"]]
    stages = [
        Stage("clips", 45.0, _clips),
        Stage("judges", 6.0, _judges),
        Stage("truth", 2.0, partial(_score_given, name=TRUTH)),
        Stage("background", 2.0, partial(_score_given, name=EMPTY)),
    ]
    for seed in seeds:
        for kind in ("on", "off"):
            stages.append(Stage(f"train-{kind}-{seed}", 62.0, partial(_train, kind=kind, seed=seed)))
            stages.append(Stage(f"score-{kind}-{seed}", 8.0, partial(_score, name=f"{kind}-{seed}")))
            if (kind, seed) == ("on", seeds[0]):
                stages += [Stage("vehicles", 3.0, _vehicles), Stage("edits", 10.0, _edits)]
        # Over the seeds so far, so that an early end leaves a figure.
        stages.append(
            Stage(f"conditioning-{seed}", 4.0, partial(_conditioning, seeds=[one for one in seeds if one <= seed]))
        )
        if seed == seeds[0]:
            stages += [
                Stage("teacher-steps", 12.0, _teacher_steps),
                Stage("distil", 70.0, _distil),
                Stage("score-distilled", 16.0, _score_distilled),
            ]
    stages += [
        Stage("train-noise", 62.0, partial(_train, kind="noise", seed=seeds[0])),
        Stage("score-noise", 8.0, partial(_score, name=f"noise-{seeds[0]}")),
    ]
    return stages


def _clips(study: Study, progress: ProgressReporter) -> Figures:
    study.make_clips(study.clips, progress)
    listed = read_list(study.clips)
    drives = {clip.drive_id for clip in study.test}
    figures = {"training": len(listed.training), "test": len(listed.test), "test_drives": len(drives)}
    for name, found in (("least_training_clips", len(listed.training)), ("least_test_drives", len(drives))):
        if found < study.declaration.clips[name]:
            raise DatasetError(f"{found} of {study.declaration.clips[name]}", file=study.clips, place=name)
    return figures


def _judges(study: Study, progress: ProgressReporter) -> Figures:
    return train_judges(study.clips, study.judges, progress, study.judge_steps)


def _score_given(study: Study, progress: ProgressReporter, *, name: str) -> Figures:
    first, given = study.references, {}
    for clip in study.test:
        given[clip.clip_id] = (clip.images if name == TRUTH else clip.background)[first:]
    return write_scores(study, name, given, progress)


def _train(study: Study, progress: ProgressReporter, *, kind: str, seed: int) -> Figures:
    if study.is_void() and kind != "noise":
        return {"void": True}
    training = study.declaration.training
    settings = study.network
    if kind == "off":
        settings = without_background(settings)
    if kind == "noise":
        settings = replace(settings, context_noise=float(training["context_noise"]))
    options = TrainingOptions(
        steps=int(training["steps"]),
        autoencoder_steps=int(training["autoencoder_steps"]),
        autoencoder=None if (kind, seed) == ("on", training["seeds"][0]) else study.autoencoder,
        settings=settings,
        autoencoder_settings=study.autoencoder_settings,
        seed=seed,
        threads=int(training["threads"]),
    )
    result = train_on_clips(study.clips, study.folder / "models" / f"{kind}-{seed}", options, progress)
    outcomes = [one for one in (result.generator_outcome, result.autoencoder_outcome) if one is not None]
    figures: Figures = {"core_s": sum(one.core_s for one in outcomes), "loss": result.generator_outcome.loss}
    if result.autoencoder_outcome is not None:
        figures["autoencoder_db"] = result.autoencoder_outcome.psnr_db
    return figures


def _score(study: Study, progress: ProgressReporter, *, name: str) -> Figures:
    if not study.model(name).is_file():
        return {"void": True}
    noise = float(study.declaration.training["context_noise"]) if name.startswith("noise") else 0.0
    steps = int(study.declaration.scoring["sampler_steps"])
    images = roll_out_all(
        study.model(name), study.autoencoder, study.test, study.folder / "rollouts" / name, steps, progress,
        context_noise=noise,
    )  # fmt: skip
    figures = write_scores(study, name, images, progress)
    return figures | _next_frame(study, name) if name.startswith("off") else figures


def _next_frame(study: Study, name: str) -> Figures:
    """PSNR of the background in frames that are generated from recorded ones, and of the frame before copied.

    A copy of the last frame reaches the declared bar in the next frame only: that of a rollout's last seed is worse
    with every frame, since the vehicle drives on.
    """
    scores = []
    for clip in study.test:
        frames = range(study.references, len(clip), _NEXT_EVERY)
        images = predict_next(
            study.model(name), study.autoencoder, [clip], frames, int(study.declaration.scoring["sampler_steps"])
        )
        before = clip.images[[frame - 1 for frame in frames]]
        scores.append(score_background(clip, frames, images[clip.clip_id], {"before": before}))
    return {"next_db": outside_db(scores, "square"), "before_db": outside_db(scores, "before")}


def _edits(study: Study, progress: ProgressReporter) -> Figures:
    scoring = study.declaration.scoring
    name = f"on-{study.declaration.training['seeds'][0]}"
    segmenter, _ = load_judges(study.judges)
    least, figures = int(scoring["mask_px"]), {}
    for dy_m in scoring["edits_m"]:
        edits = plan_declared_edits(study, float(dy_m))
        images = generate_edits(study.model(name), study.autoencoder, edits, int(scoring["sampler_steps"]), progress)
        scores = [one for edit, made in zip(edits, images) for one in score_edit(edit, made, segmenter, least)]
        figures[f"{dy_m:g}m"] = {"edits": len(edits), **(normalise(scores) if scores else {"n": 0})}
    return figures


def plan_declared_edits(study: Study, dy_m: float) -> list[Edit]:
    """Plan the declared edits of the test clips, by a distance in metres."""
    scoring = study.declaration.scoring
    return plan_edits(
        study.test,
        study.references,
        int(scoring["edit_frames"]),
        int(scoring["edits_per_clip"]),
        dy_m,
        int(scoring["mask_px"]),
        float(scoring["nearest_m"]),
    )


def _teacher_steps(study: Study, progress: ProgressReporter) -> Figures:
    """Image distance of the first model by number of steps, over the first frames of the test clips."""
    name, frames = f"on-{study.declaration.training['seeds'][0]}", int(study.declaration.distillation["teacher_frames"])
    clips = [shorten(clip, 0, min(frames, len(clip))) for clip in study.test]
    truth = _statistics(study, {clip.clip_id: clip.images[study.references :] for clip in clips}, clips)
    distances = {}
    for steps in study.declaration.distillation["teacher_steps"]:
        images = roll_out_all(
            study.model(name), study.autoencoder, clips, study.folder / "rollouts" / f"teacher-{steps}", int(steps),
            progress,
        )  # fmt: skip
        distances[str(steps)] = measure_distance(_statistics(study, images, clips), truth)
    return {"distances": distances, "best": int(min(distances, key=lambda steps: distances[steps]))}


def _distil(study: Study, progress: ProgressReporter) -> Figures:
    declared = study.declaration.distillation
    seed = int(study.declaration.training["seeds"][0])
    options = DistillationOptions(
        steps=int(declared["steps"]),
        distillation=DistillationSettings(int(declared["segments"]), int(declared["small_steps"])),
        settings=replace(study.network, learning_rate=2e-4),
        seed=seed,
        threads=int(study.declaration.training["threads"]),
    )
    out = study.model("distilled").parent
    _, outcome = distil_on_clips(study.clips, study.model(f"on-{seed}"), study.autoencoder, out, options, progress)
    return {"core_s": outcome.core_s, "loss": outcome.loss}


def _score_distilled(study: Study, progress: ProgressReporter) -> Figures:
    """The student in its number of steps, against the best teacher, over the whole test clips."""
    name = f"on-{study.declaration.training['seeds'][0]}"
    best = (study.figures("teacher-steps") or {}).get("best")
    if best is None:
        raise UsageError("the teacher's steps are not chosen yet", expected="the stage teacher-steps")
    segments = int(study.declaration.distillation["segments"])
    for model, steps, label in ((name, int(best), "teacher"), ("distilled", segments, "distilled")):
        images = roll_out_all(
            study.model(model), study.autoencoder, study.test, study.folder / "rollouts" / label, steps, progress
        )
        write_scores(study, label, images, progress)
    return {kind: asdict(_compare(study, ["distilled"], ["teacher"], kind)) for kind in ("image", "crop")} | {
        "teacher_steps": int(best)
    }


def _conditioning(study: Study, progress: ProgressReporter, *, seeds: Sequence[int]) -> Figures:
    """The ratio of the distances with and without background conditioning, over some seeds."""
    if study.is_void():
        return {"void": True}
    names = [[f"{kind}-{seed}" for seed in seeds] for kind in ("on", "off")]
    return {kind: asdict(_compare(study, names[0], names[1], kind)) for kind in ("image", "motion")}


def _vehicles(study: Study, progress: ProgressReporter) -> Figures:
    """The distance of crops, as a share of that of the empty background."""
    name = f"on-{study.declaration.training['seeds'][0]}"
    return asdict(_compare(study, [name], [EMPTY], "crop"))


def _compare(study: Study, first: list[str], second: list[str], kind: str) -> Ratio:
    scoring = study.declaration.scoring
    truth = collect_statistics(read_scores(study, TRUTH), study.drives, kind)
    models = [
        [collect_statistics(read_scores(study, one), study.drives, kind) for one in names] for names in (first, second)
    ]
    return compare(models[0], models[1], truth, resamples=int(scoring["resamples"]), level=float(scoring["level"]))


def _statistics(study: Study, images: Mapping[str, np.ndarray], clips: list[Clip]) -> Statistics:
    scores = {
        clip.clip_id: score_clip(clip, study.references, images[clip.clip_id], study.features, None) for clip in clips
    }
    return collect_statistics(scores, {clip.clip_id: clip.drive_id for clip in clips}, "image")
