"""Measure trained models against exact truth and write the results into the working folder."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.jobs import Job, exact_street_file, truth_file
from benchmarks.studies.static_reconstruction.records import EXACT_STREET_ROWS, Document, read_records
from benchmarks.studies.static_reconstruction.truth.costs import measure_costs
from benchmarks.studies.static_reconstruction.truth.exact_street import score_exact_street
from benchmarks.studies.static_reconstruction.truth.geometry import measure_geometry
from benchmarks.studies.static_reconstruction.truth.lighting import measure_lighting
from benchmarks.studies.static_reconstruction.truth.seam import measure_seams
from benchmarks.studies.static_reconstruction.truth.sweep import write_sweep
from benchmarks.studies.static_reconstruction.truth.trained import TrainedModel
from hybridworldsim.methods.street import StreetRenderer
from mirror.schema.files import write_bytes


def measure_exact_street(scene: str, width_px: int, folder: Path) -> None:
    """Score the exact street of a scene and write its scores, unless the working folder has them."""
    known = read_records(folder).exact_street
    if any((one["scene"], one["width_px"]) == (scene, width_px) for one in known):
        return
    print(f"measuring the exact street of {scene}", flush=True)
    rows = score_exact_street(folder, load_declaration(), scene, width_px)
    document = _finite(
        {"declaration": load_declaration().hash, "scene": scene, "width_px": width_px, EXACT_STREET_ROWS: rows}
    )
    path = exact_street_file(folder, scene, width_px)
    write_bytes(path, (json.dumps(document, indent=1) + "\n").encode())


def measure(job: Job, folder: Path) -> None:
    """Measure a job's model and write the result, unless the working folder has that of this very model."""
    trained, path = TrainedModel(job, folder, load_declaration()), truth_file(folder, job)
    identity = {"declaration": trained.declaration.hash, "model": trained.hash}
    if path.is_file():
        before: Document = json.loads(path.read_text())
        if {key: before[key] for key in identity} == identity:
            return
    print(f"measuring {job.name}", flush=True)
    lighting = measure_lighting(trained)
    document = {
        "job": asdict(job),
        **identity,
        **measure_geometry(trained),
        "lighting": lighting,
        "seam": measure_seams(trained),
        "costs": measure_costs(trained),
    }
    if lighting and isinstance(trained.open(), StreetRenderer):
        write_sweep(trained, path.with_suffix(".sweep.png"))
    document = _finite(document)
    write_bytes(path, (json.dumps(document, indent=1) + "\n").encode())


def _finite(value: Any) -> Any:
    """A document with None for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
