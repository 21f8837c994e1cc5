"""Gain of aligned poses in the PSNR of a reconstruction: ``python -m benchmarks calibration align --reconstruct``.

Three passes of the street of `benchmarks.calibration.alignment` (sun, clouds, rain; one front camera, an image every
2 m over 80 m) become three datasets that differ in their recorded poses alone: the exact ones, those with errors of
consumer GPS, and those that `mirror align` makes of the latter. Each is reconstructed with the same number of steps and
the same seed. Every fifth image and the last one of each pass is held out of the training and of its points, which are
sparse ones, triangulated with the poses of the dataset; the models render it at the pose that their own dataset
records. `mirror align` has used the held-out images too, as structure from motion over all images does. Road users are
neither masked nor left out. The command continues where it stopped.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.calibration.alignment import (
    PASSES,
    biased_track,
    ingest_passes,
    read_poses,
    relative_errors,
    render_passes,
    true_track,
    write_recording,
)
from benchmarks.calibration.verbs import METRICS, run_verb, shorten_protocol
from benchmarks.report import Row
from mirror.arrays import Int64
from mirror.dataset import open as open_dataset
from mirror.evaluation.result import RESULT, Result
from mirror.evaluation.submission.manifest import MANIFEST
from mirror.geometry import Poses
from mirror.geometry.geodesy import TangentFrame
from mirror.methods.model_document import read_reconstruction
from mirror.schema.files import read_json, write_bytes

VARIANTS: Final = ("exact", "aligned", "recorded")
LOSS_DB: Final = 0.3
"""Largest loss of a reconstruction on aligned poses against that on exact ones."""
_PASSES: Final = 3
_PROTOCOL: Final = "static-reconstruction-unmasked"
_SPLIT: Final = "all"


@dataclass(frozen=True)
class Training:
    """Holds what is the same in all trainings of the comparison.

    Attributes:
        steps: training images of each model.
        width_px: width of the images.
        draw: seed of the errors of the recorded poses.
    """

    steps: int = 1000
    width_px: int = 160
    draw: int = 0


def align_gain_rows(folder: Path, training: Training) -> Iterator[Row]:
    """Yield the errors of the poses between passes, and the PSNR of held-out images by the poses of the training.

    Args:
        folder: working folder; the rendered passes in it are those of the alignment.
        training: steps, width and seed of the errors.
    """
    render_passes(folder, _PASSES)
    work = folder / f"gain-{training.draw}"
    for variant in VARIANTS[::-1]:
        make_dataset(folder, work, variant, training.draw)
    base = PASSES[0][0]
    for variant in VARIANTS:
        found = read_poses(work / variant, "recorded")
        errors = [relative_errors(folder, found, name, base) for name, *_ in PASSES[1:_PASSES]]
        metres, degrees = (np.concatenate(side) for side in zip(*errors))
        yield Row(f"{variant}: error between passes, median (m)", f"{len(metres)} images", float(np.median(metres)),
                  float(np.median(degrees)), unit="deg")  # fmt: skip
    scored = {variant: reconstruct(work, variant, training) for variant in VARIANTS}
    size = f"{training.steps} steps, {training.width_px} px"
    for metric in METRICS:
        for variant in VARIANTS:
            yield Row(f"{variant}: held-out images, {metric} (dB)", size, scored[variant][metric])
        for variant in VARIANTS[1:]:
            loss = scored["exact"][metric] - scored[variant][metric]
            bar = LOSS_DB if variant == "aligned" else None
            yield Row(f"{variant}: loss in {metric} against exact poses (dB)", size, loss, bar=bar)
    for variant in VARIANTS:
        done = read_reconstruction(_model(work, variant, training)).done
        yield Row(f"{variant}: processor time of training (s)", size, done.core_s if done else np.nan)


def make_dataset(rendered: Path, work: Path, variant: str, draw: int) -> None:
    """Make the dataset of a variant, unless it is there."""
    dataset = work / variant
    if (dataset / "splits" / f"{_SPLIT}.json").is_file():
        return
    shutil.rmtree(dataset, ignore_errors=True)
    recordings = work / f"{variant}-recordings"
    shutil.rmtree(recordings, ignore_errors=True)
    aligned = _aligned_tracks(work / "recorded") if variant == "aligned" else {}
    for number, (name, *_) in enumerate(PASSES[:_PASSES]):
        if variant == "exact":
            track = true_track(rendered, name)
        else:
            track = aligned.get(name) or biased_track(rendered, number, draw)
        write_recording(rendered, recordings / name, number, *track)
    ingest_passes(rendered, recordings, dataset)
    run_verb("split", dataset, _SPLIT, "--method", "by-scene", "--train", 1, "--val", 0, "--test", 0)


def _aligned_tracks(dataset: Path) -> Mapping[str, tuple[Int64, Poses, TangentFrame]]:
    run_verb("align", dataset)
    (scene,) = open_dataset(dataset).table("scenes").to_pylist()
    frame = TangentFrame(scene["longitude_deg"], scene["latitude_deg"], scene["height_m"] or 0.0)
    return {name: (times, poses, frame) for name, (times, poses) in read_poses(dataset, "aligned@1").items()}


def _model(work: Path, variant: str, training: Training) -> Path:
    return work / f"models-{training.steps}-{training.width_px}" / variant


def reconstruct(work: Path, variant: str, training: Training) -> Mapping[str, float]:
    """Train, render and score a model: the figures of held-out images in dB by metric."""
    dataset, model = work / variant, _model(work, variant, training)
    submission, result = model.with_name(f"{variant}-renders"), model.with_name(f"{variant}-scores")
    protocol = model.with_name("protocol.toml")
    write_bytes(protocol, shorten_protocol(_PROTOCOL, "alignment-gain", training.width_px).encode())
    asked = ("--split", _SPLIT, "--protocol", protocol)
    if not (result / RESULT).is_file():
        budget = ("--steps", training.steps, "--seed", 0, "--threads", 1, "--width", training.width_px)
        start = ("--hold-out", "--initialise", "sparse", "--device", "cpu")
        run_verb("reconstruct", dataset, *asked, *start, *budget, "--out", model)
        if not (submission / MANIFEST).is_file():
            run_verb("render", dataset, model, *asked, "--device", "cpu", "--out", submission)
        run_verb("evaluate", dataset, submission, "--protocol", protocol, "--out", result, "--workers", 1)
    figures = read_json(result / RESULT, Result).figures
    return {one.metric: one.value for one in figures if one.level == "group" and one.value is not None}
