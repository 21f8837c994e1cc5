"""Reading of a dataset's files from a local folder or any file system of fsspec. Nothing is written."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Final, TypeVar
from urllib.parse import unquote, urlsplit

import pyarrow as pa

from mirror.dataset.generation import Generation
from mirror.dataset.uris import changed_error, install_hint, read_tagged, resolve_uri, uri_etag, uri_options
from mirror.errors import DatasetError, MirrorError, SchemaError, UsageError
from mirror.schema.files import Model, parse_json
from mirror.schema.links import require_inside

Result = TypeVar("Result")

_REMOTE_REQUESTS: Final = 16
_PIECE: Final = 1 << 20
_REMEDY: Final = "run `mirror index` if the file lies under index/, else restore it or ingest the recording again"


@dataclass(frozen=True)
class StoredFile:
    """A file in a store, as the store describes it.

    Attributes:
        bytes: its size.
        modified_s: when it was written last, seconds since the Unix epoch; None: the store does not say.
        etag: the tag that its store gave to its bytes, without quotation marks; None: the store gives none.
    """

    bytes: int
    modified_s: float | None = None
    etag: str | None = None


class ReadError(Exception):
    """A file that cannot be read.

    Args:
        reason: the error of its file system.

    Attributes:
        is_missing: whether there is no such file.
    """

    def __init__(self, reason: Exception) -> None:
        super().__init__(str(reason))
        self.reason = reason
        self.is_missing = isinstance(reason, FileNotFoundError | NotADirectoryError)


class Store:
    """Files below a root, by relative path.

    A local folder is read with calls of the operating system; fsspec is imported only for a URL. A link that leads out
    of a local folder is refused.

    Args:
        root: a path, or a URL that fsspec understands (``s3://bucket/dataset``, ``zip::file.zip``, ``memory://x``).
        generation: generation of a local dataset; files are read in their state of that generation.
    """

    def __init__(self, root: str | os.PathLike[str], generation: Generation | None = None) -> None:
        text = os.fspath(root)
        self.root = text
        self.folder = None if "://" in text or "::" in text else Path(text).absolute()
        self.generation = generation

    def __reduce__(self) -> tuple[Callable[..., Store], tuple[str, int | None]]:
        return (store_at, (self.root, None if self.generation is None else self.generation.number))

    def __str__(self) -> str:
        return self.root

    @cached_property
    def _remote(self) -> tuple[Any, str]:
        import fsspec

        # `zip::file.zip` has no path inside the archive: fsspec expects `zip://::file.zip`.
        head, chained, tail = self.root.partition("::")
        url = f"{head}://::{tail}" if chained and "://" not in head else self.root
        try:
            filesystem, base = fsspec.core.url_to_fs(url, **uri_options(url))
        except (ImportError, ValueError) as error:
            # The message of fsspec names the missing package or the unknown protocol.
            raise UsageError(
                f"this URL cannot be opened: {error}",
                file=self.root,
                expected="a folder, or a URL that fsspec reads with the packages installed here",
                remedy=f"{install_hint(self.root)}, or correct the URL",
            ) from error
        return filesystem, base.rstrip("/")

    def _remote_path(self, path: str) -> str:
        base = self._remote[1]
        return f"{base}/{path}" if base else path

    def full_path(self, path: str) -> str:
        """Return the full path or URL of a file, for messages; an absolute uri is returned unchanged."""
        if "://" in path:
            return path
        return str(self.folder / path) if self.folder is not None else f"{self.root.rstrip('/')}/{path}"

    def read_stable(self, path: str, read: Callable[[Path], Result]) -> Result:
        """Read a local file as it was in this store's generation.

        Args:
            path: path relative to the root.
            read: reads or opens the file at the path in its argument; called again if the file was moved meanwhile.

        Raises:
            FileNotFoundError: the file does not exist.
            DatasetError: a link leads out of the dataset.
        """
        if self.folder is None:
            raise UsageError("a remote store has no local files", file=self.root)
        if self.generation is None:
            return read(require_inside(self.folder, path))
        while True:
            place = self.generation.locate(path)
            missing: FileNotFoundError | None = None
            try:
                result = read(require_inside(self.folder, path if place is None else place.relative_to(self.folder)))
            except FileNotFoundError as error:
                missing = error
            if self.generation.locate(path) == place:
                if missing is not None:
                    raise missing
                return result

    def read(self, path: str) -> bytes:
        """Read the bytes of one file.

        Raises:
            FileNotFoundError: the file does not exist.
        """
        if self.folder is not None:
            return self.read_stable(path, Path.read_bytes)
        return bytes(self._remote[0].cat_file(self._remote_path(path)))

    def pieces(self, path: str, limit: int) -> Iterator[bytes]:
        """Read one file piece by piece, up to a number of bytes.

        Raises:
            ReadError: the file cannot be read, for whatever reason its file system has.
        """
        try:
            with self._open_stream(path) as file:
                while limit > 0 and (piece := file.read(min(limit, _PIECE))):
                    limit -= len(piece)
                    yield bytes(piece)
        except (GeneratorExit, MirrorError):
            raise
        except Exception as error:
            # Each file system of fsspec has errors of its own, which have no common base.
            raise ReadError(error) from error

    def _open_stream(self, path: str) -> Any:
        if self.folder is not None:
            return self.read_stable(path, lambda place: place.open("rb"))
        filesystem = self._remote[0]
        protocols = filesystem.protocol
        # With blocks, the file system for HTTP asks for ranges, and reads all bytes of a server that ignores them.
        is_http = bool({"http", "https"} & set((protocols,) if isinstance(protocols, str) else protocols))
        return filesystem.open(self._remote_path(path), "rb", **({"block_size": 0} if is_http else {}))

    def read_many(self, paths: Sequence[str]) -> dict[str, bytes]:
        """Read the bytes of the existing ones among some files, by path; remote files are fetched in parallel."""
        if self.folder is None:
            contents = (
                self._remote[0].cat([self._remote_path(path) for path in paths], on_error="omit") if paths else {}
            )
            return {path: bytes(contents[full]) for path in paths if (full := self._remote_path(path)) in contents}
        data = {}
        for path in paths:
            try:
                data[path] = self.read_stable(path, Path.read_bytes)
            except (FileNotFoundError, NotADirectoryError):
                continue
        return data

    def list_folders(self, path: str) -> list[str]:
        """Return the names of the folders in a folder, sorted; empty if it does not exist."""
        return self._names(path, folders=True)

    def list_files(self, path: str) -> list[str]:
        """Return the names of the files in a folder, sorted; empty if it does not exist."""
        return self._names(path, folders=False)

    def _names(self, path: str, *, folders: bool) -> list[str]:
        try:
            if self.folder is not None:
                with os.scandir(require_inside(self.folder, path)) as entries:
                    return sorted(entry.name for entry in entries if entry.is_dir() == folders)
            full = self._remote_path(path)
            # Others may have written since the file system listed it last.
            self._remote[0].invalidate_cache(full)
            listed = self._remote[0].ls(full, detail=True)
        except (FileNotFoundError, NotADirectoryError):
            return []
        return sorted(
            PurePosixPath(item["name"].rstrip("/")).name for item in listed if (item["type"] == "directory") == folders
        )

    def list_tree(self, path: str) -> dict[str, StoredFile]:
        """List all files below a remote folder, by their path relative to the root; a thousand come in one request."""
        if self.folder is not None:
            raise UsageError("a folder is walked, not listed", file=self.root)
        full = self._remote_path(path) if path else self._remote[1]
        self._remote[0].invalidate_cache(full)
        try:
            found = self._remote[0].find(full, detail=True)
        except (FileNotFoundError, NotADirectoryError):
            return {}
        start = len(self._remote_path(""))
        return {name[start:]: _describe(entry) for name, entry in sorted(found.items())}

    def list_folders_of(self, paths: Sequence[str]) -> dict[str, list[str]]:
        """List the names of the folders in several folders, by path; see `list_folders`.

        Remote requests run in parallel.
        """
        if self.folder is not None or len(paths) < 2:
            return {path: self.list_folders(path) for path in paths}
        with ThreadPoolExecutor(_REMOTE_REQUESTS) as pool:
            return dict(zip(paths, pool.map(self.list_folders, paths)))

    def json(self, path: str, model: type[Model]) -> Model:
        """Read and validate a JSON document.

        Raises:
            DatasetError: the file is missing.
            SchemaError: the file is broken or has another schema version.
        """
        try:
            data = self.read(path)
        except FileNotFoundError as error:
            raise DatasetError("missing", file=self.full_path(path), expected=f"a {model.__name__} document") from error
        return parse_json(data, model, self.full_path(path))

    def open(self, path: str) -> pa.NativeFile:
        """Open a file. An open local file is not affected when another file is renamed to its path.

        Raises:
            FileNotFoundError: the file does not exist.
        """
        if self.folder is not None:
            return self.read_stable(path, lambda place: pa.OSFile(str(place)))
        # What S3 would read beyond the asked bytes by default is larger than most tables.
        more = {"cache_type": "none"} if self.root.startswith("s3://") else {}
        return pa.PythonFile(self._remote[0].open(self._remote_path(path), "rb", **more), mode="r")

    def read_range(self, uri: str, offset: int, length: int) -> bytes:
        """Read a range of bytes of an image's uri; the result is shorter if the file ends earlier.

        Raises:
            DatasetError: a relative uri leads out of the dataset, or no installed package reads an absolute one.
            OSError: the file cannot be read.
        """

        def pread(place: Path) -> bytes:
            with place.open("rb", buffering=0) as file:
                return os.pread(file.fileno(), length, offset)

        return self.open_uri(
            uri, pread, lambda filesystem, path: bytes(filesystem.cat_file(path, start=offset, end=offset + length))
        )

    def read_whole(self, uri: str, length: int, etag: str | None = None) -> bytes:
        """Read an image that is a file of its own outside of the dataset.

        Args:
            uri: its uri.
            length: its size; the result is shorter if the file is.
            etag: the tag that its store gave to its bytes; None: it is not known.

        Raises:
            DatasetError: the file is longer, or has another tag: it was changed.
            OSError: it cannot be read.
        """
        place = self.resolve(uri)
        if isinstance(place, Path):
            data = self.read_range(uri, 0, length + 1)
        elif etag is None:
            data = bytes(place[0].cat_file(place[1], start=0, end=length + 1))
        else:
            data = read_tagged(*place, uri, length + 1, etag)
        if len(data) > length:
            raise changed_error(uri, f"has more than {length:,} bytes", f"{length:,} bytes")
        return data

    def open_uri(self, uri: str, local: Callable[[Path], Result], remote: Callable[[Any, str], Result]) -> Result:
        """Call one of two functions on an image's uri, to read or open it.

        Args:
            uri: uri in the image's row.
            local: reads or opens a local path.
            remote: reads or opens a path in an fsspec file system.

        Raises:
            DatasetError: a relative uri leads out of the dataset, or no installed package reads an absolute one.
            OSError: the file cannot be read.
        """
        if self.folder is not None and "://" not in uri and not uri.startswith("/"):
            self._require_inside(uri)
            return self.read_stable(uri, local)
        place = self.resolve(uri)
        return local(place) if isinstance(place, Path) else remote(*place)

    def resolve(self, uri: str) -> Path | tuple[Any, str]:
        """Convert an image's uri to a local path, or to an fsspec file system and a path in it.

        Raises:
            DatasetError: a relative uri leads out of the dataset, or no installed package reads an absolute one.
        """
        if "://" in uri:
            if uri.startswith("file://"):
                return Path(unquote(urlsplit(uri).path))
            return resolve_uri(uri)
        if uri.startswith("/"):
            return Path(uri)
        self._require_inside(uri)
        if self.folder is not None:
            return require_inside(self.folder, uri)
        return self._remote[0], self._remote_path(uri)

    def _require_inside(self, uri: str) -> None:
        if ".." in uri.split("/"):
            raise DatasetError(
                f"the uri {uri!r} leads out of the dataset",
                file=self.root,
                expected="a path below the dataset's root, or an absolute one",
                remedy="do not use this dataset: its tables have been tampered with",
            )


def store_at(root: str, snapshot: int | None) -> Store:
    """Make a store of a dataset as of a snapshot; for None, a store without a generation.

    Raises:
        DatasetError: the snapshot no longer exists.
    """
    if snapshot is None:
        return Store(root)
    generation = Generation.find(Path(root).absolute(), snapshot)
    if generation is None:
        raise DatasetError(
            "the index has changed since this view was made",
            file=Store(root).full_path("index"),
            remedy="open the dataset again and make the view again",
        )
    return Store(root, generation)


def unreadable_error(file: str, error: BaseException) -> SchemaError:
    """Make the error for an unreadable Parquet file."""
    return SchemaError(
        f"cannot be read ({str(error).splitlines()[0]})",
        file=file,
        expected="a complete Parquet file",
        remedy=_REMEDY,
    )


def _describe(entry: Mapping[str, Any]) -> StoredFile:
    written = entry.get("LastModified", entry.get("created"))
    return StoredFile(
        int(entry["size"]),
        written.timestamp() if isinstance(written, datetime) else None,
        uri_etag(entry),
    )
