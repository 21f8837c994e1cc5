"""Open table files. Files of the index are those of the opened view; a file that later replaced one is refused.

A row group is identified by its number in a file, and a later file of the same name has other row groups.
"""

from __future__ import annotations

import hashlib
import os
from collections import OrderedDict
from collections.abc import Collection, Mapping
from typing import Final, TypeAlias

import pyarrow as pa
import pyarrow.parquet as pq

from mirror.dataset.layout import MANIFEST
from mirror.dataset.store import Store, unreadable_error
from mirror.errors import DatasetError
from mirror.schema.documents import FileEntry, Manifest
from mirror.schema.files import parse_json, sha256_bytes
from mirror.schema.snapshot import IndexSnapshot
from mirror.schema.version import require_readable

MAX_OPEN_FILES: Final = 64
_INDEX: Final = "index/"
_CHUNK_BYTES: Final = 1024 * 1024
_WHOLE_BYTES: Final = 4 << 20
"""A remote file of the index up to this size is read as a whole, in one request, and held against its hash."""
_Identity: TypeAlias = tuple[int, int, int, int]


class TableFiles:
    """A pool of open Parquet files; beyond a limit, the least recently used file is closed.

    A local file of the index is compared with the hash in the manifest. Of a remote file only some ranges are fetched,
    so only its size is compared; a small one is fetched as a whole.

    Args:
        store: the dataset's files.
        snapshot: of the index; the manifests of its segments are read when a file of theirs is opened.
    """

    def __init__(self, store: Store, snapshot: IndexSnapshot) -> None:
        self.store = store
        self._segments = {segment.name: segment for segment in snapshot.segments}
        self._manifests: dict[str, Manifest] = {}
        self._open: OrderedDict[str, pq.ParquetFile] = OrderedDict()
        self._hashed: dict[str, _Identity] = {}

    def parquet(self, path: str) -> pq.ParquetFile:
        """Open a table file.

        Args:
            path: path relative to the dataset's root.

        Raises:
            DatasetError: the file is missing, or differs from the one in the index's manifest.
            SchemaError: the file is no complete Parquet file, or has another schema version.
        """
        if path not in self._open:
            self._open[path] = self._open_file(path)
            if len(self._open) > MAX_OPEN_FILES:
                _, oldest = self._open.popitem(last=False)
                oldest.close(force=True)
        self._open.move_to_end(path)
        return self._open[path]

    def _open_file(self, path: str) -> pq.ParquetFile:
        name = self.store.full_path(path)
        try:
            # The file is opened once, so that the compared file is also the one that is read.
            before = self._identify(path)
            file = self._open_bytes(path)
            identity = before if before == self._identify(path) else None
            if path.startswith(_INDEX) and not self._is_in_manifest(path, file, identity):
                file.close()
                raise self._changed_error(path)
            # Columns of a row group of a remote file come in one request.
            parquet = pq.ParquetFile(file, pre_buffer=self.store.folder is None)
        except FileNotFoundError as error:
            if path.startswith(_INDEX):
                raise self._changed_error(path) from error
            raise DatasetError(
                "missing",
                file=name,
                expected="a table of the dataset",
                remedy="restore it or ingest the recording again",
            ) from error
        except (pa.ArrowInvalid, OSError) as error:
            raise unreadable_error(name, error) from error
        version = (parquet.schema_arrow.metadata or {}).get(b"mirror_schema_version")
        if version is not None:
            require_readable(version.decode(), name)
        return parquet

    def _open_bytes(self, path: str) -> pa.NativeFile:
        if self.store.folder is None and path.startswith(_INDEX):
            segment, _, name = path.removeprefix(_INDEX).partition("/")
            entry = self._entries_of(segment).get(name)
            if entry is not None and entry.bytes <= _WHOLE_BYTES:
                return pa.BufferReader(self.store.read(path))
        return self.store.open(path)

    def _identify(self, path: str) -> _Identity | None:
        """The identity of a local file's state; None for a remote file."""
        if self.store.folder is None:
            return None
        status = self.store.read_stable(path, os.stat)
        return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns

    def _is_in_manifest(self, path: str, file: pa.NativeFile, identity: _Identity | None) -> bool:
        segment, _, name = path.removeprefix(_INDEX).partition("/")
        entry = self._entries_of(segment).get(name)
        if entry is None or file.size() != entry.bytes:
            return False
        if isinstance(file, pa.PythonFile):
            return True
        # A file that is opened again and has not changed is not hashed again.
        if identity is None or self._hashed.get(path) != identity:
            if _sha256(file) != entry.sha256:
                return False
            if identity is not None:
                self._hashed[path] = identity
        return True

    def manifests(self, segments: Collection[str]) -> Mapping[str, Manifest]:
        """Read the manifests of segments, by name; remote ones are fetched in parallel.

        Raises:
            DatasetError: one is missing, or is not the one that the snapshot names.
            SchemaError: one is broken.
        """
        paths = {name: f"{_INDEX}{name}/{MANIFEST}" for name in segments if name not in self._manifests}
        found = self.store.read_many(list(paths.values()))
        for name, path in paths.items():
            if path not in found or sha256_bytes(found[path]) != self._segments[name].manifest:
                raise self._changed_error(path)
            self._manifests[name] = parse_json(found[path], Manifest, self.store.full_path(path))
        return {name: self._manifests[name] for name in segments}

    def _entries_of(self, segment: str) -> Mapping[str, FileEntry]:
        """Sizes and hashes of the files of a segment, by name."""
        return self.manifests([segment])[segment].files

    def _changed_error(self, path: str) -> DatasetError:
        root = self.store.root
        return DatasetError(
            "the index has changed since this dataset was opened",
            file=self.store.full_path(path),
            expected="the file in the index's manifest at that time",
            remedy="run the same command again, or open the dataset again; if the error stays, the file is damaged: "
            f"run `mirror index {root}`",
        )


def _sha256(file: pa.NativeFile) -> str:
    digest = hashlib.sha256()
    for start in range(0, file.size(), _CHUNK_BYTES):
        digest.update(file.read_at(_CHUNK_BYTES, start))
    return digest.hexdigest()
