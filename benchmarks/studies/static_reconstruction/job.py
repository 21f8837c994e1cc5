"""One job of the comparison, in a process of its own with one thread: train, render, score, write down."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.static_reconstruction.data import layers_of, narrowed, opened, task_of
from benchmarks.studies.static_reconstruction.declared import NOVEL, Declared, declared
from benchmarks.studies.static_reconstruction.methods import Entry, entries
from benchmarks.studies.static_reconstruction.scoring import Scores, averaged, plain, scores_of
from mirror.dataset.dataset import Dataset
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.plugin import ReconstructionResult
from mirror.metrics.features.perceptual import PerceptualDistance
from mirror.metrics.features.st_lpips import load_st_lpips
from mirror.progress import NullProgress
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan, plan_views
from mirror.schema.files import write_bytes

RUNS: Final = "runs"
OUTCOMES: Final = "outcomes"
TRUTH: Final = "truth"
"""Of what is measured against exact truth."""
CEILING: Final = "ceiling"
"""Before the first dot of the names of such files that are of no model, but of the exact street itself."""


@dataclass(frozen=True)
class Job:
    """What is to be trained and scored.

    Attributes:
        entry: row of the comparison.
        scene: which.
        seed: of the training.
        core_minutes: of training.
        width_px: of the pictures.
    """

    entry: str
    scene: str
    seed: int
    core_minutes: float
    width_px: int

    @property
    def name(self) -> str:
        """Of its folder and its outcome."""
        return f"{self.entry}.{self.scene}.{self.core_minutes:g}min.{self.width_px}px.{self.seed}"


def read_outcome(path: Path) -> dict[str, Any] | None:
    """An outcome that is there, of the declaration and of the settings of its row as they are now."""
    if not path.is_file():
        return None
    document: dict[str, Any] = json.loads(path.read_text())
    job = Job(**document["job"])
    entry = entries().get(job.entry)
    now = entry is not None and document.get("settings") == entry.settings(job.seed)
    return document if now and document["declaration"] == declared().hash else None


def read_ceilings(folder: Path) -> dict[Path, dict[str, Any]]:
    """What is written down of the exact street under the declaration as it is now."""
    there = {path: json.loads(path.read_text()) for path in sorted((folder / TRUTH).glob(f"{CEILING}.*.json"))}
    return {path: document for path, document in there.items() if document["declaration"] == declared().hash}


def run(job: Job, folder: Path) -> Path:
    """Do a job, or go on where it was stopped; its outcome is written last."""
    declaration = declared()
    outcome = folder / OUTCOMES / f"{job.name}.json"
    entry = entries()[job.entry]
    # Before hours of training are spent: it says what to install.
    network = load_st_lpips()
    dataset = opened(folder)
    split = entry.split or declaration.split
    task = task_of(declaration, job.scene, split, job.width_px, job.core_minutes, job.seed)
    model = folder / RUNS / job.name
    done = entry.method.reconstruct(dataset, task, model, NullProgress())
    plan = plan_views(dataset.where(scene=job.scene), narrowed(declaration, job.width_px), split)
    scores = _scored(entry, model, dataset, plan, declaration, network)
    document = {
        "job": asdict(job),
        "declaration": declaration.hash,
        "settings": entry.settings(job.seed),
        "dataset_hash": plan.dataset_hash,
        "plan_hash": plan.hash,
        "layers": layers_of(dataset, split, job.scene, str(done.points)),
        **_costs(done),
        **scores,
    }
    # What was measured of a model that this one takes the place of says nothing of this one.
    (folder / TRUTH / outcome.name).unlink(missing_ok=True)
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


def _scored(
    entry: Entry, model: Path, dataset: Dataset, plan: Plan, declaration: Declared, network: PerceptualDistance
) -> dict[str, Any]:
    truth = GroundTruth(dataset, plan.protocol, plan.layers)
    groups = [group.name for group in plan.protocol.groups]
    render = entry.method.open(model, AppearancePolicy(declaration.policy, plan.views))
    scores = scores_of(render, plan, truth, groups, network)
    oracle = _oracle(entry, model, dataset, plan, truth)
    return {
        "means": {group: averaged(scores, group) for group in groups},
        "oracle": averaged(oracle, NOVEL),
        "scores": plain(scores),
    }


def _oracle(entry: Entry, model: Path, dataset: Dataset, plan: Plan, truth: GroundTruth) -> list[Scores]:
    """The held-out pictures with the looks of that training traversal with which they score best."""
    own = dataset.where(split=plan.split, role="train", scene=plan.views[0].scene_id)
    tried = [
        scores_of(entry.method.open(model, AppearancePolicy(traversal, plan.views)), plan, truth, [NOVEL])
        for traversal in own.traversals()
    ]
    return max(tried, key=lambda scores: averaged(scores, NOVEL)["psnr_cc"])


def main(argv: list[str]) -> int:
    """``python -m benchmarks.studies.static_reconstruction.job FOLDER JOB`` with the job as JSON."""
    print(run(Job(**json.loads(argv[1])), Path(argv[0])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
