"""Rows of the ``boxes`` table from the columns that a dataset has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_exp
from mirror.schema.tables import BOXES


def make_box_table(ego_SE3_box: Poses, size_m: Float64, columns: Mapping[str, Any]) -> pa.Table:
    """Make rows of the ``boxes`` table, sorted by time; equal times keep their order.

    Args:
        ego_SE3_box: N poses.
        size_m: (N, 3) length, width and height.
        columns: the other columns by name: N values, or a text that all rows share. Absent columns are null.
    """
    count = len(ego_SE3_box)
    sizes = dict(zip(("length_m", "width_m", "height_m"), size_m.T))
    given = {**columns, **sizes, **ego_SE3_box.to_columns()}
    given = {name: [values] * count if isinstance(values, str) else values for name, values in given.items()}
    arrays = [
        pa.array(given[field.name], field.type if pa.types.is_nested(field.type) else None)
        if field.name in given
        else pa.nulls(count, field.type)
        for field in BOXES.schema
    ]
    table = pa.table(arrays, names=BOXES.schema.names).cast(BOXES.schema)
    return table.take(pa.array(np.argsort(np.asarray(table.column("timestamp_ns")), kind="stable")))


def rotation_about_up(yaw_rad: Float64) -> Float64:
    """Return (N, 4) quaternions of boxes that are given by their yaw (N,), counter-clockwise from x."""
    return quaternion_exp(np.outer(yaw_rad, (0.0, 0.0, 1.0)))


def velocity_columns(velocity_mps: Float64) -> dict[str, pa.Array]:
    """Convert (N, 3) velocities along the ego frame's axes to the velocity columns; NaN becomes null."""
    unknown = np.isnan(velocity_mps).any(axis=1)
    return {
        name: pa.array(np.ascontiguousarray(values), mask=unknown)
        for name, values in zip(("vx_mps", "vy_mps", "vz_mps"), velocity_mps.T)
    }
