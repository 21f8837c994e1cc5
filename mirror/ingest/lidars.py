"""The lidar sweeps of an accepted pass: references to their files in a layer of their own; no file is opened.

They are a layer, as recorded boxes are, and no table of the recorded folder: that folder leaves whole, so that hashes
of published datasets are those of their source, and paths of a fleet's own files must not leave.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa

from mirror.dataset.layout import Layout, seal
from mirror.ingest.passes import DrivePasses
from mirror.ingest.trigger import Pass
from mirror.recordings.lidars import LidarSweeps
from mirror.schema.files import encode_table, write_bytes
from mirror.schema.tables import LIDARS

SOURCE: Final = ("recorded", "1")
"""Source and version of the layer."""


def write_lidars(layout: Layout, name: str, drive: DrivePasses, one: Pass, derived_from: Mapping[str, str]) -> None:
    """Write the sweeps within a pass, if there are any.

    Args:
        layout: the dataset.
        name: the traversal.
        drive: its drive.
        one: its pass.
        derived_from: hashes of the inputs of the traversal.

    Raises:
        RecordingError: the sweeps cannot be listed.
        DatasetError: the table cannot be written.
    """
    rows = [row for sweeps in drive.content.lidars() for row in _rows(sweeps, one)]
    if not rows:
        return
    rows.sort(key=lambda row: tuple(row[key] for key in LIDARS.sorted_by))
    data = encode_table(pa.Table.from_pylist(rows, schema=LIDARS.schema), LIDARS)
    folder = layout.layer(name, LIDARS.name, *SOURCE)
    write_bytes(folder / f"{LIDARS.name}.parquet", data)
    seal(folder, {f"{LIDARS.name}.parquet": data}, derived_from=derived_from)


def _rows(sweeps: LidarSweeps, one: Pass) -> list[dict[str, Any]]:
    stamps = sweeps.timestamp_ns
    inside = np.flatnonzero((stamps >= one.entry_ns) & (stamps <= one.exit_ns)).tolist()
    poses = {name: values.tolist() for name, values in sweeps.ego_SE3_sensor.to_columns().items()}
    return [
        {
            "sensor": sweeps.sensor,
            "timestamp_ns": int(stamps[row]),
            "format": sweeps.format,
            "uri": sweeps.uris[row],
            "byte_length": None,
            "sha256": None,
            **{key: values[row] for key, values in poses.items()},
        }
        for row in inside
    ]
