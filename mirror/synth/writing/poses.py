"""Writes the recorded poses of a drive, in any of the layouts that fleets deliver."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import AnyArray, Int64
from mirror.geometry import heading_deg, matrix_from_quaternion, quaternion_from_matrix
from mirror.portable import arrays
from mirror.recordings.time import GPS_EPOCH_NS
from mirror.schema.files import write_bytes
from mirror.synth.errors import Errors
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.seeds import random_stream

_LEAP_NS: Final = 18 * 1_000_000_000
# Coarser than the last bit, in which processors differ (see `mirror.portable`), and finer than 0.02 mm.
_DECIMALS_DEG: Final = 10
_DECIMALS_M: Final = 6
_DECIMALS_QUATERNION: Final = 9


def pose_stamps(drive: SynthDrive) -> Int64:
    """Return the Unix times (N,) of a drive's poses, in nanoseconds."""
    time_s = np.arange(0.0, drive.truth.duration_s, 1.0 / drive.preset.pose_hz)
    return drive.condition.start_ns + np.round(time_s * 1e9).astype(np.int64)


def write_poses(folder: Path, drive: SynthDrive, errors: Errors) -> None:
    """Write ``poses.*`` of a recording in the layout that the drive's recipe names."""
    stamps = pose_stamps(drive)
    rng = random_stream("pose errors", drive.seed, 1)
    measured = errors.perturb_poses(drive.world_SE3_ego(stamps), drive.seconds(stamps), rng)
    longitude, latitude, height = drive.frame.to_geodetic(measured.translation)
    enu_R_world = np.swapaxes(drive.frame.world_R_enu(longitude, latitude), 1, 2)
    rotation = quaternion_from_matrix(arrays.matmul(enu_R_world, matrix_from_quaternion(measured.rotation)))
    style = drive.recipe.poses
    columns: dict[str, AnyArray] = {"timestamp_ns": stamps}
    if style == "gps":
        columns = {"timestamp": (stamps - GPS_EPOCH_NS + _LEAP_NS) // 1000}
    columns |= {"longitude_deg": longitude.round(_DECIMALS_DEG), "latitude_deg": latitude.round(_DECIMALS_DEG)}
    if style == "heading":
        columns["heading_deg"] = heading_deg(rotation).round(_DECIMALS_QUATERNION)
    else:
        columns["height_m"] = height.round(_DECIMALS_M)
        rotation = rotation.round(_DECIMALS_QUATERNION)
        columns |= {name: rotation[:, axis] for axis, name in enumerate(("qw", "qx", "qy", "qz"))}
    if errors.sigma_m > 0.0:
        columns["sigma_m"] = np.full(len(stamps), errors.sigma_m)
    table = pa.table(columns)
    if style == "parquet":
        import pyarrow.parquet as pq

        sink = pa.BufferOutputStream()
        pq.write_table(table, sink)
        write_bytes(folder / "poses.parquet", sink.getvalue().to_pybytes())
    elif style == "parts":
        length = -(-table.num_rows // 3)
        for part in range(3):
            _write_csv(folder / "poses" / f"part-{part}.csv", table.slice(part * length, length))
    else:
        _write_csv(folder / "poses.csv", table)


def _write_csv(path: Path, table: pa.Table) -> None:
    import pyarrow.csv as csv

    sink = pa.BufferOutputStream()
    csv.write_csv(table, sink, csv.WriteOptions(quoting_style="none"))
    write_bytes(path, sink.getvalue().to_pybytes())
