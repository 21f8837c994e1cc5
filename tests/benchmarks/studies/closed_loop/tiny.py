"""The study at a tiny size: one small street, two policies, two scenarios, rollouts of a second."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

import mirror
from benchmarks.studies.closed_loop.declaration import FILE, Declaration, make_declaration
from benchmarks.studies.closed_loop.records import Records
from benchmarks.studies.closed_loop.study import Study
from mirror.dataset.dataset import Dataset
from mirror.dataset.images.depth_codec import encode_depth
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.schema.tables import DEPTH, POINTS

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
        _add_points(mirror.open(street))
    return Study(folder / "out", declaration, Records(folder / "outcomes.jsonl", declaration.hash))


def _add_points(dataset: Dataset) -> None:
    """Points of walls on either side of the training traversals, and a depth map of each."""
    train = dataset.where(split="novel", role="train")
    poses = train.table("ego_poses", ["tx_m", "ty_m", "tz_m"])
    middle = np.array([column.to_numpy().mean() for column in poses.columns])
    rng, layout = np.random.default_rng(0), Layout(Path(dataset.root))
    for traversal in train.traversals():
        places = middle + np.column_stack(
            [rng.uniform(-40.0, 40.0, 150), rng.choice((-12.0, 12.0), 150), rng.uniform(0.0, 8.0, 150)]
        )
        same = {"r": 90, "g": 90, "b": 90, "kind": "background", "views": 3, "sigma_m": None}
        rows = [
            {"point": number, "x_m": x, "y_m": y, "z_m": z, **same} for number, (x, y, z) in enumerate(places.tolist())
        ]
        LayerWriter(layout, traversal, "points", "made", "1").finish(POINTS, rows, {})
        depth = LayerWriter(layout, traversal, "depth", "made", "1")
        lens = {"width_px": 6, "height_px": 4, "fx_px": 5.0, "fy_px": 5.0, "cx_px": 3.0, "cy_px": 2.0}
        image = dataset.where(traversal=traversal).frames()[0].images["front_wide"]
        flat = depth.file("map.png", encode_depth(np.full((4, 6), 9.0)))
        depth.finish(DEPTH, [{"camera": "front_wide", "timestamp_ns": image.timestamp_ns, **lens, **flat}], {})
    build_index(Path(dataset.root))
