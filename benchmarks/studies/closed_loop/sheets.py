"""Sheets of images: the same drive in every world, one row for each world.

The policy that reads the exact state drives, so that all worlds are seen from the same places.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.studies.closed_loop.driving import PrivilegedPolicy
from benchmarks.studies.closed_loop.rollouts import drive
from benchmarks.studies.closed_loop.stages import EXACT
from benchmarks.studies.closed_loop.study import Study
from mirror.schema.files import write_bytes

_COLUMNS: Final = 6


def write_sheets(study: Study, out: Path) -> list[Path]:
    """Write a sheet for each light, of the first scenario and the first seed with it, in the worlds that are there."""
    methods = [name for name in study.plan().methods if _is_made(study, name)]
    cases = {case.light: case for case in reversed(study.cases(study.plan().seeds))}
    written = []
    for light, case in sorted(cases.items()):
        rows = []
        for name in (EXACT, *methods):
            policy = PrivilegedPolicy(study.settings, study.declaration.camera["name"])
            images = drive(
                policy, study.scenario(case, 1.0), study.place(case), study.worlds(name)[case.street], study.settings,
                float(study.declaration.report["horizon_s"]), keep_images=True,
            ).images  # fmt: skip
            frames = np.linspace(0, len(images) - 1, _COLUMNS).astype(int)
            rows.append(np.concatenate([images[frame] for frame in frames], axis=1))
        path = out / f"{case.scenario}-{light}.png"
        write_bytes(path, cv2.imencode(".png", np.concatenate(rows)[..., ::-1])[1].tobytes())
        written.append(path)
    return written


def _is_made(study: Study, method: str) -> bool:
    seeds = study.declaration.streets["seeds"]
    return all(f"model-{method}-{seed}" in study.records.stages for seed in seeds) and all(
        study.model_folder(method, seed).is_dir() for seed in seeds
    )
