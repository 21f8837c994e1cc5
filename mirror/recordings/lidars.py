"""Lidar sweeps of a recording: their files by reference, with stamps and poses. No file is opened.

A recording states its sweeps by an optional method ``lidars()``, which returns one `LidarSweeps` a sensor; a reader
without it has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.recordings.protocol import Recording


@dataclass(frozen=True, eq=False)
class LidarSweeps:
    """The N sweeps of one lidar.

    Attributes:
        sensor: the source's name of the lidar.
        format: name of the format of the files, in lower case: ``kitti_velodyne_bin``, ``nuscenes_pcd_bin``,
            ``dgp_npz``, ``av2_feather``, or another one.
        timestamp_ns: (N,) Unix time, UTC, of each sweep, as its source defines it.
        uris: N absolute paths, or URLs that fsspec reads.
        ego_SE3_sensor: N poses: from the frame of the points of a file to the ego frame at its stamp.

    Raises:
        RecordingError: the numbers of stamps, files and poses differ, or a path is not absolute.
    """

    sensor: str
    format: str
    timestamp_ns: Int64
    uris: tuple[str, ...] = field(repr=False)
    ego_SE3_sensor: Poses = field(repr=False)

    def __post_init__(self) -> None:
        counts = len(self.timestamp_ns), len(self.uris), len(self.ego_SE3_sensor)
        if len(set(counts)) != 1:
            raise RecordingError(
                "{} stamps, {} files and {} poses".format(*counts), place=f"lidar {self.sensor}",
                expected="one of each a sweep", remedy="mend the reader: each sweep has a stamp, a file and a pose",
            )  # fmt: skip
        for uri in self.uris:
            if not (uri.startswith("/") or "://" in uri):
                raise RecordingError(
                    f"the path {uri} is not absolute", place=f"lidar {self.sensor}",
                    expected="an absolute path or a URL: the dataset lies elsewhere", remedy="mend the reader",
                )  # fmt: skip

    def __len__(self) -> int:
        return len(self.timestamp_ns)


def read_lidars(recording: Recording) -> Sequence[LidarSweeps]:
    """Return the lidar sweeps of a recording; none if its reader has no method ``lidars``."""
    sweeps: Sequence[LidarSweeps] = getattr(recording, "lidars", tuple)()
    return sweeps


def repeat_pose(pose: Poses, count: int) -> Poses:
    """Return one mounting for a number of sweeps."""
    return pose[np.zeros(count, np.int64)]
