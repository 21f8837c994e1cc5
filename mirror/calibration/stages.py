"""The calibration stages of a dataset beside each other: differences, validity intervals, and jumps in time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any, Final

import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.dataset.traversal import STAGES
from mirror.geometry import Poses, matrix_from_quaternion

JUMP_DEG: Final = 0.1
JUMP_CM: Final = 1.0
_ORDER: Final = tuple(reversed(STAGES))


@dataclass(frozen=True)
class StageDifference:
    """The difference between two stages of one camera, or between two consecutive rows of one stage.

    Attributes:
        vehicle_id: the vehicle.
        drive_id: the drive.
        camera: the camera.
        first: the earlier stage.
        second: the later stage; the same for a jump in time.
        angle_deg: total angle.
        axes_deg: roll, pitch, yaw about the vehicle's axes.
        distance_cm: distance of the positions.
        at_ns: start of the later row's validity, or of its drive; None for two stages of one drive without one.
    """

    vehicle_id: str
    drive_id: str
    camera: str
    first: str
    second: str
    angle_deg: float
    axes_deg: tuple[float, float, float]
    distance_cm: float
    at_ns: int | None

    @property
    def is_jump(self) -> bool:
        """Return whether the difference is between rows of one stage and above the limit of an unexplained change."""
        return self.first == self.second and (self.angle_deg > JUMP_DEG or self.distance_cm > JUMP_CM)


@dataclass(frozen=True)
class StageHistory:
    """All calibrations of a dataset's drives.

    Attributes:
        rows: rows of the calibrations tables, each once, by vehicle, drive, camera, stage and start of validity.
        between_stages: differences between any two stages of a camera.
        in_time: differences between consecutive rows of one camera and stage.
    """

    rows: Sequence[Mapping[str, Any]]
    between_stages: Sequence[StageDifference]
    in_time: Sequence[StageDifference]


def compare_stages(dataset: Dataset) -> StageHistory:
    """Compare the recorded calibrations of a dataset with each other and with its calibration layers.

    Traversals of one drive hold the same rows; they count once. Rows of one stage in time order give the jumps: within
    a drive, and from drive to drive of a vehicle.
    """
    rows = _distinct_rows(dataset)
    groups: dict[tuple[str, str, str], dict[str, list[Mapping[str, Any]]]] = {}
    for row in rows:
        key = row["vehicle_id"], row["drive_id"], row["camera"]
        groups.setdefault(key, {}).setdefault(row["stage"], []).append(row)
    between = [
        compare_rows(stages[first][-1], stages[second][-1])
        for stages in groups.values()
        for first, second in combinations([stage for stage in _ORDER if stage in stages], 2)
    ]
    starts = _drive_starts(dataset)
    series: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: (starts[row["drive_id"]], row["valid_from_ns"] or 0)):
        series.setdefault((row["vehicle_id"], row["camera"], row["stage"]), []).append(row)
    in_time = []
    for own in series.values():
        for one, other in pairwise(own):
            at_ns = starts[other["drive_id"]] if other["valid_from_ns"] is None else other["valid_from_ns"]
            in_time.append(replace(compare_rows(one, other), at_ns=at_ns))
    return StageHistory(rows, between, in_time)


def compare_rows(one: Mapping[str, Any], other: Mapping[str, Any]) -> StageDifference:
    """Return the difference of two rows of the calibrations table, the second relative to the first."""
    first, second = (pose_of_row(row) for row in (one, other))
    turn = Poses((second @ first.inverse()).rotation, np.zeros((1, 3))).log()[0, :3]
    axes = np.degrees(turn)
    return StageDifference(
        vehicle_id=other["vehicle_id"],
        drive_id=other["drive_id"],
        camera=other["camera"],
        first=one["stage"],
        second=other["stage"],
        angle_deg=float(np.linalg.norm(axes)),
        axes_deg=(float(axes[0]), float(axes[1]), float(axes[2])),
        distance_cm=100.0 * float(np.linalg.norm(second.translation - first.translation)),
        at_ns=other["valid_from_ns"],
    )


def pose_of_row(row: Mapping[str, Any]) -> Poses:
    """Return the mounting ``ego_SE3_camera`` of a row of the calibrations table, one pose."""
    return Poses.from_columns({name: [row[name]] for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")})


def rotation_of_row(row: Mapping[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the rotation (3, 3) of a row's mounting."""
    return np.asarray(matrix_from_quaternion(pose_of_row(row).rotation)[0], np.float64)


def _drive_starts(dataset: Dataset) -> dict[str, int]:
    """Return when each drive first entered a scene."""
    starts: dict[str, int] = {}
    for row in dataset.table("traversals", ["drive_id", "entry_ns"]).to_pylist():
        starts[row["drive_id"]] = min(row["entry_ns"], starts.get(row["drive_id"], row["entry_ns"]))
    return starts


def _distinct_rows(dataset: Dataset) -> list[Mapping[str, Any]]:
    found: dict[tuple[object, ...], Mapping[str, Any]] = {}
    for row in _all_rows(dataset):
        start = row["valid_from_ns"]
        key = (row["vehicle_id"], row["drive_id"], row["camera"], _ORDER.index(row["stage"]),
               -1 if start is None else start, *pose_of_row(row).to_columns().values())  # fmt: skip
        found.setdefault(tuple(part if isinstance(part, str | int) else float(part[0]) for part in key), row)
    return [found[key] for key in sorted(found, key=lambda key: key[:5])]


def _all_rows(dataset: Dataset) -> Iterator[Mapping[str, Any]]:
    from mirror.schema.tables import CALIBRATIONS

    yield from dataset.table("calibrations", CALIBRATIONS.schema.names).to_pylist()
    columns = dataset.catalog.columns
    for traversal, layers in zip(*dataset.table("traversals", ["traversal_id", "layers"]).to_pydict().values()):
        for layer in layers:
            kind, _, name = layer.partition("/")
            if kind == "calibrations":
                path = f"traversals/{traversal}/layers/{kind}/{name}/calibrations.parquet"
                names = CALIBRATIONS.schema.names
                values = [column.to_pylist() for column in columns.read(path, 0, names)]
                yield from (dict(zip(names, row)) for row in zip(*values))
