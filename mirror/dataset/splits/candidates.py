"""The traversals that a split assigns, with the data that decides whether two of them may have different roles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa

from mirror.arrays import UInt8
from mirror.dataset.index.global_tables import accepted_passes, read_passes
from mirror.dataset.index.inputs import read_inputs
from mirror.dataset.layout import Layout
from mirror.dataset.store import Store
from mirror.schema.documents import Roi
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES, Table

SHA256_BYTES = 32


@dataclass(frozen=True)
class Candidate:
    """One traversal that a split may assign.

    Attributes:
        traversal_id: the traversal.
        scene_id: its scene.
        drive_id: its drive.
        vehicle_id: the drive's vehicle.
        entry_ns: time of the entry, Unix.
        exit_ns: time of the exit, Unix.
        light: light at the entry.
        weather: weather at the entry.
        content: SHA-256 over the recorded files.
        has_images: False for a drive without cameras.
    """

    traversal_id: str
    scene_id: str
    drive_id: str
    vehicle_id: str
    entry_ns: int
    exit_ns: int
    light: str
    weather: str
    content: str
    has_images: bool = True


@dataclass(frozen=True)
class Candidates:
    """All traversals of a dataset, and its scenes.

    Attributes:
        layout: the dataset.
        scenes: its regions of interest by id.
        traversals: its traversals by id, sorted.
        read: reads some columns of a table; it returns None for an unreadable table.
    """

    layout: Layout
    scenes: Mapping[str, Roi]
    traversals: Mapping[str, Candidate]
    read: Callable[[Path, Table, Sequence[str]], pa.Table | None] = read_table

    @cached_property
    def image_hashes(self) -> Mapping[str, UInt8]:
        """SHA-256 (N, 32) of the recorded images, by traversal, without images that have no hash."""
        files = {key: self.layout.recorded(key) / f"{IMAGES.name}.parquet" for key in self.traversals}
        tables = {key: self.read(file, IMAGES, ["sha256"]) for key, file in files.items()}
        return {key: hash_bytes(data.column(0)) for key, data in tables.items() if data is not None}


def read_candidates(layout: Layout) -> Candidates:
    """Read the traversals from the recorded files; the index is not needed.

    Raises:
        DatasetError: the folder holds no dataset, or a traversal or ledger is missing.
        SchemaError: a file is broken or has another schema version.
    """
    inputs = read_inputs(Store(layout.root))
    ledger = accepted_passes(read_passes(layout, inputs))
    traversals = {
        key: Candidate(
            traversal_id=key,
            scene_id=item.scene_id,
            drive_id=item.drive.drive_id,
            vehicle_id=item.drive.vehicle_id,
            entry_ns=ledger[key]["entry_ns"],
            exit_ns=ledger[key]["exit_ns"],
            light=ledger[key]["light"],
            weather=ledger[key]["weather"],
            content=item.recorded.content,
            has_images=item.drive.rig_id is not None,
        )
        for key, item in inputs.traversals.items()
    }
    return Candidates(layout, inputs.scenes, traversals)


def hash_bytes(column: pa.ChunkedArray) -> UInt8:
    """Return the non-null hashes of a column as bytes (N, 32)."""
    values = column.drop_null().combine_chunks()
    if not len(values):
        return np.empty((0, SHA256_BYTES), np.uint8)
    data = np.frombuffer(values.buffers()[1], np.uint8)
    start = values.offset * SHA256_BYTES
    return data[start : start + len(values) * SHA256_BYTES].reshape(-1, SHA256_BYTES)
