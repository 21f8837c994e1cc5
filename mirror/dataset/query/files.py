"""Table files, open; those of the index are the ones that a view was opened on, never what later took their place.

Row groups are known by their number in a file; in a later file of the same name they are others.
"""

from __future__ import annotations

import hashlib
import os
from collections import OrderedDict
from collections.abc import Mapping
from typing import Final, TypeAlias

import pyarrow as pa
import pyarrow.parquet as pq

from mirror.dataset.store import Store, unreadable
from mirror.errors import DatasetError
from mirror.schema.documents import FileEntry
from mirror.schema.version import require_readable

MAX_OPEN_FILES: Final = 64
_INDEX: Final = "index/"
_CHUNK_BYTES: Final = 1024 * 1024
_Identity: TypeAlias = tuple[int, int, int, int]


class TableFiles:
    """Open Parquet files, up to a number: least recently used is closed first.

    A local file of the index is held against the manifest's hash, a remote one, of which only some ranges are fetched,
    against its size.

    Args:
        store: where the files are.
        entries: what the index's manifest says of its files, by name.
    """

    def __init__(self, store: Store, entries: Mapping[str, FileEntry]) -> None:
        self.store = store
        self._entries = entries
        self._open: OrderedDict[str, pq.ParquetFile] = OrderedDict()
        self._hashed: dict[str, _Identity] = {}

    def parquet(self, path: str) -> pq.ParquetFile:
        """An open table file.

        Args:
            path: relative to the dataset's root.

        Raises:
            DatasetError: the file is missing, or not the one that the index's manifest names.
            SchemaError: it is not a complete Parquet file, or of another schema version.
        """
        if path not in self._open:
            self._open[path] = self._opened(path)
            if len(self._open) > MAX_OPEN_FILES:
                _, oldest = self._open.popitem(last=False)
                oldest.close(force=True)
        self._open.move_to_end(path)
        return self._open[path]

    def _opened(self, path: str) -> pq.ParquetFile:
        name = self.store.full_path(path)
        try:
            # What was held against the manifest is what is read: the name is not looked up a second time.
            file = self.store.open(path)
            if path.startswith(_INDEX) and not self._is_named(path, file):
                file.close()
                raise self._changed(path)
            parquet = pq.ParquetFile(file)
        except FileNotFoundError as error:
            if path.startswith(_INDEX):
                raise self._changed(path) from error
            raise DatasetError(
                "missing",
                file=name,
                expected="a table of the dataset",
                remedy="restore it or ingest the recording again",
            ) from error
        except (pa.ArrowInvalid, OSError) as error:
            raise unreadable(name, error) from error
        version = (parquet.schema_arrow.metadata or {}).get(b"mirror_schema_version")
        if version is not None:
            require_readable(version.decode(), name)
        return parquet

    def _is_named(self, path: str, file: pa.NativeFile) -> bool:
        entry = self._entries.get(path.removeprefix(_INDEX))
        if entry is None or file.size() != entry.bytes:
            return False
        if not isinstance(file, pa.OSFile):
            return True
        # A file that was closed for room and is opened again is not read through again.
        status = os.fstat(file.fileno())
        identity = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
        if self._hashed.get(path) != identity:
            if _sha256(file) != entry.sha256:
                return False
            self._hashed[path] = identity
        return True

    def _changed(self, path: str) -> DatasetError:
        root = self.store.root
        return DatasetError(
            "the index has changed since this dataset was opened",
            file=self.store.full_path(path),
            expected="the file that the index's manifest named then",
            remedy=f"open it again: mirror.open({root!r}); if the error stays, the file is damaged: "
            f"run `mirror index {root}`",
        )


def _sha256(file: pa.NativeFile) -> str:
    digest = hashlib.sha256()
    for start in range(0, file.size(), _CHUNK_BYTES):
        digest.update(file.read_at(_CHUNK_BYTES, start))
    return digest.hexdigest()
