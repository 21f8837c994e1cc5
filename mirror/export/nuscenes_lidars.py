"""Lidar sweeps in the tables of nuScenes: files with rows of ``sample_data``, mountings and poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.frames import Frame
from mirror.export.lidars import Sweep, SweepFiles, list_sweeps, present_sweeps
from mirror.export.scene import ExportScene
from mirror.geometry.interpolation import interpolate
from mirror.recordings.readers.nuscenes_lidars import OWN_FORMAT, ending_of_format

AddRow = Callable[..., str]
"""Adds a row to a table, by the parts of its key and the values of its columns; returns its token."""


def sweep_files(scene: ExportScene) -> SweepFiles:
    """Return the places of the sweeps of a scene."""
    sweeps, notes = present_sweeps(list_sweeps(scene))
    places = {sweep_path(key, one): one for key, every in sweeps.items() for one in every}
    foreign = sorted({one.format for one in places.values()} - {OWN_FORMAT})
    if foreign:
        notes = (*notes, f"lidar sweeps have the format {', '.join(foreign)}, which the devkit does not read")
    return SweepFiles(places, notes)


def sweep_path(traversal_id: str, sweep: Sweep) -> str:
    """Return the path of the file of a sweep below the export's folder."""
    channel = lidar_channel(sweep.sensor)
    name = f"{traversal_id}__{channel}__{to_us(sweep.timestamp_ns)}{ending_of_format(sweep.format)}"
    return f"samples/{channel}/{name}"


def lidar_channel(sensor: str) -> str:
    """Return the name of a lidar's channel."""
    return sensor if sensor.upper().startswith("LIDAR") else f"LIDAR_{sensor.upper()}"


def to_us(timestamp_ns: int) -> int:
    """Round a stamp to microseconds."""
    return (timestamp_ns + 500) // 1000


def add_sweeps(
    add: AddRow, traversal_id: str, drive_id: str, frame: Frame, sweeps: Sequence[Sweep], samples: Mapping[str, int]
) -> dict[str, list[str]]:
    """Add the rows of the sweeps of a traversal.

    Args:
        add: adds a row.
        traversal_id: the traversal.
        drive_id: its drive.
        frame: one of its frames, which knows its track.
        sweeps: by sensor and time.
        samples: stamps of the samples, microseconds, by token, in order of time.

    Returns:
        Tokens of ``sample_data`` by channel, in order of time.
    """
    tokens = list(samples)
    times = np.array(list(samples.values()), np.float64)
    found: dict[str, list[str]] = {}
    for sensor in dict.fromkeys(one.sensor for one in sweeps):
        own = [one for one in sweeps if one.sensor == sensor]
        stamps = np.array([one.timestamp_ns for one in own], np.int64)
        ego = interpolate(*frame.track, stamps)
        nearest, is_key = _match(stamps / 1e3, times)
        channel = lidar_channel(sensor)
        token = add("sensor", channel, channel=channel, modality="lidar")
        found[channel] = []
        for row, one in enumerate(own):
            mounted: dict[str, Any] = {
                "translation": one.ego_SE3_sensor.translation[0].tolist(),
                "rotation": one.ego_SE3_sensor.rotation[0].tolist(),
            }
            calibrated = add(
                "calibrated_sensor", drive_id, channel, *mounted.values(), sensor_token=token, **mounted,
                camera_intrinsic=[],
            )  # fmt: skip
            key, time = (traversal_id, channel, one.timestamp_ns), to_us(one.timestamp_ns)
            pose = add(
                "ego_pose", *key, timestamp=time, rotation=ego.rotation[row].tolist(),
                translation=ego.translation[row].tolist(),
            )  # fmt: skip
            form = "pcd" if one.format == OWN_FORMAT else one.format
            found[channel].append(
                add(
                    "sample_data", *key, sample_token=tokens[nearest[row]], ego_pose_token=pose,
                    calibrated_sensor_token=calibrated, timestamp=time, fileformat=form,
                    is_key_frame=bool(is_key[row]), height=0, width=0, filename=sweep_path(traversal_id, one),
                )
            )  # fmt: skip
    return found


def _match(sweeps_us: Float64, samples_us: Float64) -> tuple[list[int], list[bool]]:
    """The nearest sample of each sweep, and whether the sweep is the nearest of that sample, within half a period."""
    apart = np.abs(sweeps_us[:, None] - samples_us[None])
    nearest = apart.argmin(axis=1)
    half = 0.5 * float(np.median(np.diff(sweeps_us))) if len(sweeps_us) > 1 else np.inf
    is_key = (apart.argmin(axis=0)[nearest] == np.arange(len(sweeps_us))) & (apart.min(axis=1) <= half)
    return nearest.tolist(), is_key.tolist()
