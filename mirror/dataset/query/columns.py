"""A cache of decoded columns of row groups. Beyond a limit in bytes, the least recently used columns are dropped."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import Final

import pyarrow as pa

from mirror.dataset.query.files import TableFiles
from mirror.dataset.store import unreadable_error
from mirror.schema.parquet_memory import require_memory
from mirror.schema.tables import ADDED

CACHE_BYTES: Final = 48 * 1024 * 1024


class ColumnCache:
    """A cache of columns of Parquet files, which it reads by row group.

    Args:
        files: the files.
        limit_bytes: largest size of the cached columns.
    """

    def __init__(self, files: TableFiles, limit_bytes: int = CACHE_BYTES) -> None:
        self._files = files
        self.limit_bytes = limit_bytes
        self._held = 0
        self.columns: OrderedDict[tuple[str, int, str], pa.Array] = OrderedDict()
        # Arrow's reader is not safe for use by several threads at once.
        self._lock = threading.Lock()

    @property
    def held_bytes(self) -> int:
        """Size of the cached columns in bytes."""
        return self._held

    def row_groups(self, path: str) -> int:
        """Return the number of row groups of a file.

        Raises:
            DatasetError: the file is missing, or differs from the one in the index's manifest.
            SchemaError: the file is broken.
        """
        with self._lock:
            return int(self._files.parquet(path).metadata.num_row_groups)

    def read(self, path: str, row_group: int, names: Sequence[str]) -> list[pa.Array]:
        """Read columns of one row group; each is one contiguous array.

        Raises:
            DatasetError: the file is missing, or differs from the one in the index's manifest.
            SchemaError: the file is broken.
        """
        with self._lock:
            missing = [name for name in names if (path, row_group, name) not in self.columns]
            decoded = self.decode(path, row_group, missing) if missing else {}
            arrays = []
            for name in names:
                key = (path, row_group, name)
                if name in decoded:
                    arrays.append(decoded[name])
                else:
                    self.columns.move_to_end(key)
                    arrays.append(self.columns[key])
            for name, column in decoded.items():
                self.columns[(path, row_group, name)] = column
                self._held += column.nbytes
            while self._held > self.limit_bytes:
                _, dropped = self.columns.popitem(last=False)
                self._held -= dropped.nbytes
            return arrays

    def decode(self, path: str, row_group: int, names: Sequence[str]) -> dict[str, pa.Array]:
        """Read columns of one row group by name from the file, without caching them."""
        file = self._files.parquet(path)
        added = [name for name in names if name in ADDED and name not in file.schema_arrow.names]
        try:
            present = [name for name in names if name not in added]
            require_memory(file, self._files.store.full_path(path), present, row_group=row_group)
            table = file.read_row_group(row_group, columns=present, use_threads=False)
            for name in added:
                rows = file.metadata.row_group(row_group).num_rows
                table = table.append_column(name, pa.chunked_array([pa.nulls(rows, ADDED[name])]))
            columns = [table.column(name) for name in names]
        except (pa.ArrowInvalid, OSError, KeyError) as error:
            raise unreadable_error(self._files.store.full_path(path), error) from error
        return {
            name: column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
            for name, column in zip(names, columns)
        }
