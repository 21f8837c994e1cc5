"""Splits with fewer training traversals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.methods import entries
from benchmarks.studies.static_reconstruction.scenes import hash_layers, write_reduced_split
from mirror.dataset import Dataset
from mirror.dataset.dataset import open as open_dataset
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.schema.tables import POINTS
from tests.baselines.conftest import dataset as street  # noqa: F401 - a fixture


@pytest.mark.parametrize(
    ("count", "kept"), [(1, {"oncoming"}), (2, {"oncoming", "near"}), (3, {"oncoming", "near", "far"})]
)
def test_nearest_and_held_out_traversals_are_kept(
    street: Dataset,  # noqa: F811
    count: int,
    kept: set[str],
) -> None:
    write_reduced_split(street, load_declaration(), count)
    path = Path(street.root) / "splits" / f"novel-{count}.json"
    roles = json.loads(path.read_text())["assignments"]
    named = {traversal.split(".")[1]: role for traversal, role in roles.items()}
    assert {name for name, role in named.items() if role == "train"} == set(("oncoming", "near", "far")[:count])
    assert named["new"] == "held_out" and set(named.values()) <= {"train", "held_out", "unused"}
    opened = open_dataset(street.root)
    assert len(opened.where(split=f"novel-{count}", role="train").traversals()) == count
    before = path.stat().st_mtime_ns
    write_reduced_split(opened, load_declaration(), count)
    assert path.stat().st_mtime_ns == before


def test_rows_of_fewer_traversals_have_their_splits() -> None:
    assert entries()["1-traversals"].split == entries()["omnire_style-single"].split == "novel-1"
    assert entries()["1-traversals"].settings(0)["split"] == "novel-1" and "split" not in entries()["ours"].settings(0)


def test_outcomes_record_their_layers(street: Dataset) -> None:  # noqa: F811
    def written(version: str, x_m: float) -> dict[str, str]:
        for traversal in street.where(split="novel", role="train").traversals():
            row = {
                "point": 0, "x_m": x_m, "y_m": 0.0, "z_m": 0.0, "r": 0, "g": 0, "b": 0, "kind": "background",
                "views": 2, "sigma_m": None,
            }  # fmt: skip
            LayerWriter(Layout(Path(street.root)), traversal, "points", "made", version).finish(POINTS, [row], {})
        return hash_layers(street, "novel", "street", f"made@{version}")

    one, other = written("1", 1.0), written("2", 2.0)
    assert one["points"] != other["points"] and one["depth"] == other["depth"]
    assert hash_layers(street, "novel", "street", "made@1") == one
