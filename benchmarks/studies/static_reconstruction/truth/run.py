"""Measures trained models, one after the other, and writes down what came of it beside the outcomes."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.studies.static_reconstruction.declared import declared
from benchmarks.studies.static_reconstruction.job import CEILING, OUTCOMES, TRUTH, Job, read_ceilings, read_outcome
from benchmarks.studies.static_reconstruction.truth.ceiling import ceiling_of
from benchmarks.studies.static_reconstruction.truth.costs import costs_of
from benchmarks.studies.static_reconstruction.truth.geometry import geometry_of
from benchmarks.studies.static_reconstruction.truth.lighting import lighting_of
from benchmarks.studies.static_reconstruction.truth.seam import seam_of
from benchmarks.studies.static_reconstruction.truth.sweep import write_sweep
from benchmarks.studies.static_reconstruction.truth.tables import Measured
from benchmarks.studies.static_reconstruction.truth.trained import Trained
from hybridworldsim.methods.street import OpenStreet
from mirror.schema.files import write_bytes


def measured(folder: Path) -> list[Measured]:
    """What is written down of models whose outcomes count, see `read_outcome`; the models may be gone."""
    there = sorted((folder / TRUTH).glob("*.json"))
    return [json.loads(path.read_text()) for path in there if read_outcome(folder / OUTCOMES / path.name) is not None]


def measure_ceiling(scene: str, width_px: int, folder: Path) -> None:
    """Score the exact street of a scene and write it down, unless that is done."""
    if any((one["scene"], one["width_px"]) == (scene, width_px) for one in read_ceilings(folder).values()):
        return
    print(f"measuring the exact street of {scene}", flush=True)
    rows = ceiling_of(folder, declared(), scene, width_px)
    document = _known({"declaration": declared().hash, "scene": scene, "width_px": width_px, CEILING: rows})
    path = folder / TRUTH / f"{CEILING}.{scene}.{width_px}px.json"
    write_bytes(path, (json.dumps(document, indent=1) + "\n").encode())


def measure(job: Job, folder: Path) -> None:
    """Measure a job's model and write it down, unless that is done of this very model."""
    trained, path = Trained(job, folder, declared()), folder / TRUTH / f"{job.name}.json"
    identity = {"declaration": trained.declaration.hash, "model": trained.hash}
    if path.is_file():
        before: Measured = json.loads(path.read_text())
        if {key: before[key] for key in identity} == identity:
            return
    print(f"measuring {job.name}", flush=True)
    lighting = lighting_of(trained)
    document = {
        "job": asdict(job),
        **identity,
        **geometry_of(trained),
        "lighting": lighting,
        "seam": seam_of(trained),
        "costs": costs_of(trained),
    }
    if lighting and isinstance(trained.open(), OpenStreet):
        write_sweep(trained, path.with_suffix(".sweep.png"))
    document = _known(document)
    write_bytes(path, (json.dumps(document, indent=1) + "\n").encode())


def _known(value: Any) -> Any:
    """JSON has no number for what is unknown or infinite."""
    if isinstance(value, dict):
        return {key: _known(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_known(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
