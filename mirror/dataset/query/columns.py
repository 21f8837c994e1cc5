"""A cache of decoded columns of row groups. Beyond a limit in bytes, the least recently used columns are dropped."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import pyarrow as pa

from mirror.dataset.query.files import TableFiles
from mirror.dataset.store import unreadable_error
from mirror.schema.parquet_memory import require_memory
from mirror.schema.tables import ADDED

CACHE_BYTES: Final = 48 * 1024 * 1024
_JOINED: Final = -1
"""In place of the number of a row group: columns over several files."""


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

    @property
    def files(self) -> TableFiles:
        """The files that it reads."""
        return self._files

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
            return self._keep(path, row_group, names, decoded)

    def join(self, place: str, names: Sequence[str], make: Callable[[list[str]], pa.Table]) -> list[pa.Array]:
        """Return columns that are made of those of several files, and keep them as others are kept.

        Args:
            place: where they belong; no path of a file.
            names: of the columns.
            make: makes those that are not held, each in one chunk.
        """
        with self._lock:
            missing = [name for name in names if (place, _JOINED, name) not in self.columns]
            held = {name: self.columns[place, _JOINED, name] for name in names if name not in missing}
        made = make(missing) if missing else None
        with self._lock:
            # Those that are held may have made room for others meanwhile.
            added = {name: column for name, column in held.items() if (place, _JOINED, name) not in self.columns}
            if made is not None:
                added |= {name: made.column(name).combine_chunks() for name in missing}
            return self._keep(place, _JOINED, names, added)

    def _keep(self, path: str, row_group: int, names: Sequence[str], added: Mapping[str, pa.Array]) -> list[pa.Array]:
        """Return columns of which some are added now; those that were used least recently make room."""
        arrays = []
        for name in names:
            key = (path, row_group, name)
            if name not in added:
                self.columns.move_to_end(key)
            arrays.append(added[name] if name in added else self.columns[key])
        for name, column in added.items():
            before = self.columns.pop((path, row_group, name), None)
            self._held += column.nbytes - (0 if before is None else before.nbytes)
            self.columns[path, row_group, name] = column
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
