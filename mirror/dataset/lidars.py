"""Lidar sweeps of a traversal: references to the files of its source, with stamps and poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.geometry.poses import COLUMNS, Poses
from mirror.schema.files import read_table
from mirror.schema.tables import LIDARS

LIDAR_LAYER: Final = "lidars/recorded@1"
"""The layer of the references; a published dataset, a release and a fetched part do not have it."""


@dataclass(frozen=True, eq=False)
class LidarFiles:
    """N sweeps of one lidar in one format, in order of time; the files were never opened.

    Attributes:
        sensor: the source's name of the lidar.
        format: format of the files, such as ``kitti_velodyne_bin``; `mirror.schema.tables.LIDARS` names more.
        timestamp_ns: (N,) Unix time, UTC.
        uris: N absolute paths or URLs; a file may be missing.
        ego_SE3_sensor: N poses: from the frame of the points of a file to the ego frame at its stamp.
    """

    sensor: str
    format: str
    timestamp_ns: Int64
    uris: tuple[str, ...]
    ego_SE3_sensor: Poses

    def __len__(self) -> int:
        return len(self.timestamp_ns)


def read_lidar_files(store: Store, traversal_id: str) -> tuple[LidarFiles, ...]:
    """Read the references of a traversal, by sensor and format.

    Args:
        store: files of the dataset.
        traversal_id: the traversal, which has the layer.

    Raises:
        DatasetError: the table is missing.
        SchemaError: the table is broken.
    """
    path = f"traversals/{traversal_id}/layers/{LIDAR_LAYER}/{LIDARS.name}.parquet"
    try:
        data = store.read(path)
    except FileNotFoundError as error:
        raise DatasetError(
            "missing", file=store.full_path(path), expected="the table that the index lists",
            remedy="`mirror check` lists all that is missing",
        ) from error  # fmt: skip
    rows = read_table(Path(store.full_path(path)), LIDARS, data=data)
    names = list(zip(rows.column("sensor").to_pylist(), rows.column("format").to_pylist()))
    stamps = np.asarray(rows.column("timestamp_ns"), np.int64)
    uris = rows.column("uri").to_pylist()
    numbers = np.column_stack([np.asarray(rows.column(name), np.float64) for name in COLUMNS])
    found = []
    for name in sorted(set(names)):
        own = np.array([row for row, one in enumerate(names) if one == name], np.int64)
        poses = Poses(numbers[own, :4], numbers[own, 4:])
        found.append(LidarFiles(*name, stamps[own], tuple(uris[row] for row in own.tolist()), poses))
    return tuple(found)
