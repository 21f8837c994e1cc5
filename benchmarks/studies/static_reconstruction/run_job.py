"""Run one job of the study in a process of its own with one thread: train, render, score, write the outcome."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.studies.static_reconstruction.declaration import NOVEL, Declaration, load_declaration
from benchmarks.studies.static_reconstruction.jobs import Job, model_folder, outcome_file, truth_file
from benchmarks.studies.static_reconstruction.methods import Entry, entries
from benchmarks.studies.static_reconstruction.scenes import hash_layers, make_task, open_scenes, protocol_at
from benchmarks.studies.static_reconstruction.scoring import Scores, average_scores, score_views, scores_as_json
from mirror.dataset.dataset import Dataset
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.plugin import ReconstructionResult
from mirror.metrics.features.perceptual import PerceptualDistance
from mirror.metrics.features.st_lpips import load_st_lpips
from mirror.progress import NullProgress
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan, plan_views
from mirror.schema.files import write_bytes


def run(job: Job, folder: Path) -> Path:
    """Run a job, or continue it where it was stopped; its outcome is written last.

    Args:
        job: what to train and score.
        folder: working folder of the study.

    Returns:
        The file of the outcome.
    """
    declaration = load_declaration()
    entry = entries()[job.entry]
    # Before hours of training are spent: its error says what to install.
    network = load_st_lpips()
    dataset = open_scenes(folder)
    split = entry.split or declaration.split
    task = make_task(declaration, job.scene, split, job.width_px, job.core_minutes, job.seed)
    model = model_folder(folder, job)
    done = entry.method.reconstruct(dataset, task, model, NullProgress())
    plan = plan_views(dataset.where(scene=job.scene), protocol_at(declaration, job.width_px), split)
    scores = _score_model(entry, model, dataset, plan, declaration, network)
    document = {
        "job": asdict(job),
        "declaration": declaration.hash,
        "settings": entry.settings(job.seed),
        "dataset_hash": plan.dataset_hash,
        "plan_hash": plan.hash,
        "layers": hash_layers(dataset, split, job.scene, str(done.points)),
        **_costs(done),
        **scores,
    }
    # A former model's errors against exact truth say nothing of this one.
    truth_file(folder, job).unlink(missing_ok=True)
    outcome = outcome_file(folder, job)
    write_bytes(outcome, (json.dumps(document, indent=1) + "\n").encode())
    return outcome


def _costs(done: ReconstructionResult) -> dict[str, Any]:
    return {
        "steps": done.steps,
        "core_s": done.core_s,
        "gaussians": done.gaussians,
        "model_bytes": done.model_bytes,
        "driven_m": done.driven_m,
        "pictures": done.pictures,
    }


def _score_model(
    entry: Entry, model: Path, dataset: Dataset, plan: Plan, declaration: Declaration, network: PerceptualDistance
) -> dict[str, Any]:
    truth = GroundTruth(dataset, plan.protocol, plan.layers)
    groups = [group.name for group in plan.protocol.groups]
    render = entry.method.open(model, AppearancePolicy(declaration.policy, plan.views))
    scores = score_views(render, plan, truth, groups, network)
    oracle = _score_best_appearance(entry, model, dataset, plan, truth)
    return {
        "means": {group: average_scores(scores, group) for group in groups},
        "oracle": average_scores(oracle, NOVEL),
        "scores": scores_as_json(scores),
    }


def _score_best_appearance(entry: Entry, model: Path, dataset: Dataset, plan: Plan, truth: GroundTruth) -> list[Scores]:
    """Scores of the held-out images in the appearance of the training traversal that has the best PSNR*."""
    training = dataset.where(split=plan.split, role="train", scene=plan.views[0].scene_id)
    candidates = [
        score_views(entry.method.open(model, AppearancePolicy(traversal, plan.views)), plan, truth, [NOVEL])
        for traversal in training.traversals()
    ]
    return max(candidates, key=lambda scores: average_scores(scores, NOVEL)["psnr_cc"])


def main(argv: list[str]) -> int:
    """Return ``python -m benchmarks.studies.static_reconstruction.run_job FOLDER JOB`` with the job as JSON."""
    print(run(Job(**json.loads(argv[1])), Path(argv[0])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
