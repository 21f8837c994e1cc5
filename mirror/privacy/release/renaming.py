"""New names and clocks for a release: pseudonyms that hold for one release, and times shifted drive by drive."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from mirror.schema.documents import DriveDocument
from mirror.schema.tables import KEY

_DURATIONS: Final = frozenset(("time_offset_ns", "readout_ns"))
"""Columns in nanoseconds that are no instants."""
_DIGITS: Final = 12


@dataclass(frozen=True)
class Renaming:
    """The name of a drive in a release, and the shift of its clock.

    Attributes:
        drive_id: id of the drive in the dataset.
        new_drive_id: its id in the release.
        new_vehicle_id: pseudonym of the vehicle in the release.
        shift_ns: added to every instant.
    """

    drive_id: str
    new_drive_id: str
    new_vehicle_id: str
    shift_ns: int

    def traversal(self, traversal_id: str) -> str:
        """Return the id of a traversal in the release: ``scene.drive.entry_ms``."""
        scene, _, entry_ms = traversal_id.split(".")
        entry_ns = int(entry_ms) * 1_000_000 + self.shift_ns
        return f"{scene}.{self.new_drive_id}.{entry_ns // 1_000_000}"

    def table(self, data: pa.Table, traversals: Mapping[str, str]) -> pa.Table:
        """Return a table with the new ids, times and uris.

        Args:
            data: a recorded table, the table of a layer, or the ledger.
            traversals: new ids of the drive's traversals.
        """
        for position, name in enumerate(data.column_names):
            column = data.column(name)
            if name.endswith("_ns") and name not in _DURATIONS and self.shift_ns:
                column = pc.add(column, pa.scalar(self.shift_ns, pa.int64()))
            elif name == "drive_id":
                column = _constant(column, self.new_drive_id)
            elif name == "vehicle_id":
                column = _constant(column, self.new_vehicle_id)
            elif name == "traversal_id":
                values = column.cast(pa.string()).to_pylist()
                column = pa.array([None if value is None else traversals.get(value) for value in values], pa.string())
            else:
                continue
            data = data.set_column(position, data.schema.field(name), column.cast(data.schema.field(name).type))
        return data


def rename_drive(drive: DriveDocument, key: bytes | None, grain_s: int) -> Renaming:
    """Choose the names and the clock of a drive.

    Args:
        drive: the drive.
        key: key of the release, from which pseudonyms are derived (HMAC-SHA256), so that only who has it can link
            them; None: the ids of the dataset are kept.
        grain_s: the drive's clock is shifted so that its start is a multiple of this; 1: not shifted.
    """
    grain_ns = grain_s * 1_000_000_000
    # Whole milliseconds, so that the ids of traversals, which hold their entry in milliseconds, shift exactly.
    shift_ns = -((drive.start_ns % grain_ns) // 1_000_000) * 1_000_000 if grain_s > 1 else 0
    if key is None:
        return Renaming(drive.drive_id, drive.drive_id, drive.vehicle_id, shift_ns)
    return Renaming(
        drive.drive_id,
        f"drive-{_pseudonym(key, 'drive', drive.drive_id)}",
        f"vehicle-{_pseudonym(key, 'vehicle', drive.vehicle_id)}",
        shift_ns,
    )


def _pseudonym(key: bytes, kind: str, name: str) -> str:
    return hmac.new(key, f"{kind}:{name}".encode(), hashlib.sha256).hexdigest()[:_DIGITS]


def _constant(column: pa.ChunkedArray, value: str) -> pa.Array:
    return pa.repeat(pa.scalar(value, pa.string()), len(column)).cast(KEY)
