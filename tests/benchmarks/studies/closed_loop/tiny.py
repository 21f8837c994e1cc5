"""The study at a tiny size: one small street, two policies, two scenarios, rollouts of a second."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path
from typing import Any

import mirror
from benchmarks.studies.closed_loop.declaration import FILE, Declaration, make_declaration
from benchmarks.studies.closed_loop.records import Records
from benchmarks.studies.closed_loop.study import Study
from mirror.dataset.dataset import Dataset
from tests.builders.lanes import add_initial_points

SEED = 0


def tiny_document() -> dict[str, Any]:
    """The declaration's document with tiny values."""
    document = tomllib.loads(FILE.read_text())
    # The only trained drive of the tiny dataset stands for day and night.
    document["streets"] |= {"preset": "tiny", "seeds": [SEED], "day": "01", "night": "01", "split": "novel"}
    document["camera"] |= {"width_px": 48, "height_px": 27}
    document["reconstruction"] |= {
        "methods": ["vanilla_3dgs"], "block_m": 200.0, "core_minutes": 0.005, "width_px": 32, "initialise": "made@1",
    }  # fmt: skip
    document["images"] |= {"sites": ["guangzhou-urban"], "seeds": [SEED], "validation_seed": SEED, "drives": {"01": 3}}
    document["training"] |= {"steps": 2, "batch": 2}
    document["policies"] = {"full": {}, "strong": {"augmentation": "strong", "images": 2}}
    document["scenarios"] |= {"names": ["hard-brake"], "duration_s": 0.6, "seeds": [0]}
    document["triggers"] |= {"scales": [1.0, 0.5], "policies": ["full"], "seeds": [5]}
    document["references"] |= {"seeds": [0]}
    document["report"] |= {"resamples": 5}
    document["budget"] |= {"pilot_rollouts": 2, "pilot_core_minutes": 0.005, "fewer_seeds": []}
    return document


def tiny_study(folder: Path, dataset: Dataset, document: dict[str, Any] | None = None) -> Study:
    """A study in a folder, with the tiny dataset as its street."""
    declaration: Declaration = make_declaration(document or tiny_document())
    street = folder / "out" / "streets" / f"street-{SEED}" / "dataset"
    if not street.exists():
        shutil.copytree(dataset.root, street)
        add_initial_points(mirror.open(street))
    return Study(folder / "out", declaration, Records(folder / "outcomes.jsonl", declaration.hash))
