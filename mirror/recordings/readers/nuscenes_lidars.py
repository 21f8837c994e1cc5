"""Lidar sweeps of nuScenes: rows of ``sample_data`` whose sensor is a lidar. Names of files state their formats.

The devkit reads ``.pcd.bin``: five float32 a point. Exports of other sources keep their files, whose names end in
their format, such as ``.kitti_velodyne.bin``.
"""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.recordings.lidars import LidarSweeps
from mirror.recordings.paths import require_files_inside
from mirror.recordings.readers.json_tables import entry_errors
from mirror.recordings.readers.nuscenes_rows import SensorData
from mirror.recordings.readers.nuscenes_tables import Tables
from mirror.recordings.readers.stored_poses import require_poses

OWN_FORMAT: Final = "nuscenes_pcd_bin"
_OWN_ENDING: Final = ".pcd.bin"


def read_sweeps(tables: Tables, data: SensorData, last_us: int) -> tuple[LidarSweeps, ...]:
    """Return the sweeps of each lidar of a scene.

    Args:
        tables: the folder's tables.
        data: the rows of the scene that are read.
        last_us: the largest stamp that fits into nanoseconds.

    Raises:
        RecordingError: a mounting is no pose, or a name leads out of the folder.
    """
    channels = {number: tables.sensors[number] for number in np.unique(data.sensor).tolist()}
    lidars = sorted({sensor.channel for sensor in channels.values() if sensor.modality == "lidar"})
    found = []
    for channel in lidars:
        rows = data.take(np.isin(data.sensor, [number for number, one in channels.items() if one.channel == channel]))
        rows = rows.take(np.argsort(rows.timestamp_us, kind="stable"))
        names = rows.filename.to_pylist()
        paths = require_files_inside(tables.root, names, file=tables.folder / "sample_data.json")
        numbers, which = np.unique(rows.sensor, return_inverse=True)
        file, states = tables.folder / "calibrated_sensor.json", []
        for number in numbers.tolist():
            token = f"token {channels[number].token} ({channel})"
            with entry_errors(file, token, "rotation and translation"):
                record = channels[number].record
                states.append([float(value) for key in ("rotation", "translation") for value in record[key]])
                if len(states[-1]) != 7:
                    raise ValueError(f"{len(states[-1])} numbers")
        mounted = np.array(states)
        poses = require_poses(mounted[:, :4], mounted[:, 4:], file=file, place=f"{channel}, row {{}}".format)
        forms = np.array([format_of_name(name) for name in names])
        stamps: Int64 = np.clip(rows.timestamp_us, -last_us, last_us) * 1_000
        for form in sorted(set(forms.tolist())):
            mine = np.flatnonzero(forms == form)
            uris = tuple(str(paths[row].absolute()) for row in mine.tolist())
            found.append(LidarSweeps(channel, form, stamps[mine], uris, poses[which[mine]]))
    return tuple(found)


def ending_of_format(form: str) -> str:
    """Return the ending of the name of a file: ``.pcd.bin``, or the format with a dot before its last word."""
    if form == OWN_FORMAT:
        return _OWN_ENDING
    family, _, suffix = form.rpartition("_")
    return f".{family}.{suffix}" if family else f".{suffix}"


def format_of_name(name: str) -> str:
    """Return the format that the name of a file states; the inverse of `ending_of_format`."""
    if name.endswith(_OWN_ENDING):
        return OWN_FORMAT
    *others, suffix = PurePosixPath(name).name.split(".")
    named = len(others) > 1 and others[-1].isidentifier()
    return f"{others[-1]}_{suffix}" if named else f"nuscenes_{suffix}"
