"""Trains the judges on the training clips and checks them on the test clips; resumable."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from safetensors.torch import load_file, save
from torch import nn

from benchmarks.studies.generation.judge_data import collect_crops, collect_masks
from benchmarks.studies.generation.judges import (
    Classifier,
    JudgeTrainer,
    Segmenter,
    balanced_accuracy,
    classifier_loss,
    classify,
    mask_ious,
    segment,
    segmenter_loss,
)
from hybridworldsim.generation.clips.clip import CATEGORIES
from hybridworldsim.generation.clips.folder import read_clips, read_list
from hybridworldsim.generation.training.documents import GenerationOutcome, GenerationRun
from hybridworldsim.generation.training.numbered import numbered_training
from hybridworldsim.training.run.folder import MODEL, RunFolder
from hybridworldsim.training.run.loop import train
from mirror.progress import ProgressReporter
from mirror.schema.files import write_bytes
from mirror.weights.resolve import file_sha256

STEPS: Final = {"segmenter": 1500, "classifier": 1500}
"""Budget: six core-minutes together."""
_EVERY: Final = 3


def train_judges(
    clips: Path, out: Path, progress: ProgressReporter, steps: dict[str, int] | None = None
) -> dict[str, Any]:
    """Train both judges, check them, and write ``judges.json``.

    Args:
        clips: folder of clips.
        out: folder of the judges.
        progress: receives the progress.
        steps: number of steps by judge; None: `STEPS`.

    Returns:
        The figures on the test clips.
    """
    torch.set_num_threads(1)
    steps = STEPS if steps is None else steps
    listed = read_list(clips)
    training, test = read_clips(clips, listed.training), read_clips(clips, listed.test)
    clips_hash = file_sha256(clips / "clips.json")

    torch.manual_seed(0)
    segmenter, classifier = Segmenter(), Classifier()
    masks = collect_masks(training, _EVERY)
    _train(out, "segmenter", segmenter, segmenter_loss(segmenter, *masks), steps, clips_hash, progress)
    crops, classes = collect_crops(training)
    _train(out, "classifier", classifier, classifier_loss(classifier, crops, classes), steps, clips_hash, progress)

    images, backgrounds, true = collect_masks(test, _EVERY)
    ious = mask_ious(segment(segmenter, images, backgrounds), true)
    test_crops, test_classes = collect_crops(test)
    found = classify(classifier, test_crops)
    counts = Counter(CATEGORIES[one] for one in test_classes.tolist())
    most = counts.most_common(1)[0][1] / len(test_classes)
    figures = {
        "segmenter_iou": float(ious.mean()),
        "segmenter_masks": len(ious),
        "classifier_accuracy": float((found == test_classes).mean()),
        "classifier_balanced_accuracy": balanced_accuracy(found, test_classes),
        "classifier_crops": len(test_classes),
        "commonest_class": float(most),
        "test_crops_by_class": dict(counts),
        "training_crops": len(classes),
    }
    write_bytes(out / "judges.json", json.dumps(figures, indent=1).encode())
    return figures


def load_judges(out: Path) -> tuple[Segmenter, Classifier]:
    """Return the trained judges."""
    judges = Segmenter(), Classifier()
    for name, network in zip(("segmenter", "classifier"), judges):
        network.load_state_dict(load_file(out / name / MODEL))
        network.eval().requires_grad_(False)
    return judges


def _train(
    out: Path,
    name: str,
    network: nn.Module,
    loss: Any,
    steps: dict[str, int],
    clips_hash: str,
    progress: ProgressReporter,
) -> None:
    folder = RunFolder(out / name, GenerationOutcome)
    run = GenerationRun(
        part=name, settings={}, seed=0, steps=steps[name], threads=1, processes=1, clips_hash=clips_hash,
        autoencoder_hash=None,
    )  # fmt: skip

    def write(path: Path) -> int:
        data = save(network.state_dict())
        write_bytes(path, data)
        return len(data)

    if folder.begin(run) is None:
        with folder.claim(run):
            trainer = JudgeTrainer(network, loss, steps[name])
            train(numbered_training(trainer, steps[name], write, phase=name, loss="loss"), folder, progress)
    network.load_state_dict(load_file(folder.model))
    network.eval().requires_grad_(False)


def background_baseline_db(images: np.ndarray, backgrounds: np.ndarray, masks: np.ndarray) -> float:
    """Return the PSNR of the empty street copied, outside the masks of road users, in dB."""
    error = ((images.astype(np.float64) - backgrounds) / 255.0)[~masks]
    return float(-10.0 * np.log10((error**2).mean()))
