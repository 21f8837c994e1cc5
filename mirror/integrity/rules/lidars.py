"""Rules of LID: references to lidar sweeps. Their files lie outside of the dataset and are not opened."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mirror.integrity.finding import Cost, Finding, Severity
from mirror.integrity.motion import MotionColumns
from mirror.integrity.rule import scene_rule
from mirror.integrity.scene_view import SceneView


@scene_rule(
    "LID001",
    Severity.WARNING,
    title="The file of a lidar sweep is not at its place, so that exports lack it. URLs are not asked.",
    cost=Cost.FILES,
    remedy="mount the recording where it was, or `mirror ingest RECORDING... --replace` from where it is",
)
def _missing_sweep(view: SceneView) -> Iterator[Finding]:
    rows = view.lidars
    places = [None if "://" in uri else uri for uri in rows.data.column("uri").to_pylist()]
    missing = np.array([place is not None and not Path(place).is_file() for place in places], np.bool_)
    yield from rows.findings(missing, lambda row: f"unverified: {rows.text('uri', row)} is not there")


@scene_rule(
    "LID002",
    Severity.ERROR,
    title="The stamp of a lidar sweep is outside of its pass.",
    remedy="correct the stamps in the recording, and `mirror ingest RECORDING... --replace`",
)
def _sweep_outside(view: SceneView) -> Iterator[Finding]:
    rows = view.lidars
    stamps, entry, exit_ = rows.integers("timestamp_ns"), view.entry_ns[rows.traversal], view.exit_ns[rows.traversal]
    yield from rows.findings(
        (stamps < entry) | (stamps > exit_),
        lambda row: f"{stamps[row]}; the pass lasts from {entry[row]} to {exit_[row]}",
    )


@scene_rule(
    "LID003",
    Severity.ERROR,
    title="The pose of a lidar sweep has a quaternion that is not of unit length, or a number that is not finite.",
    remedy="correct the calibration of the recording, and `mirror ingest RECORDING... --replace`",
)
def _sweep_pose(view: SceneView) -> Iterator[Finding]:
    rows = view.lidars
    placed = MotionColumns(rows)
    yield from rows.findings(
        ~(placed.unit & np.isfinite(placed.position).all(axis=1)),
        lambda row: f"{placed.rotation[row].tolist()}, {placed.position[row].tolist()} m",
    )
