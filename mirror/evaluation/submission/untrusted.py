"""Files that nobody vouches for: a folder or a zip, listed and read within limits; links and odd names are refused.

Nothing is unpacked, followed or executed: a name is only ever compared with those that are expected.
"""

from __future__ import annotations

import os
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Protocol

from mirror.errors import MirrorError, UsageError
from mirror.schema.strict_json import JsonError, decode_json

MAX_ENTRIES: Final = 2_000_000
_MOST_DEPTH: Final = 16
_MOST_RATIO: Final = 200
_RATIO_FROM_BYTES: Final = 1 << 20
_ZIP: Final = b"PK\x03\x04"


class UntrustedError(MirrorError):
    """A submission that is refused as a whole."""


class UntrustedFiles(Protocol):
    """The files of a submission, by their path in it."""

    where: str
    sizes: dict[str, int]
    refused: dict[str, str]

    def read(self, path: str, max_bytes: int) -> bytes:
        """The bytes of a listed file.

        Raises:
            UntrustedError: it is larger than allowed, changed, or cannot be read.
        """


def open_untrusted(path: Path) -> UntrustedFiles:
    """The files of a folder or a zip.

    Raises:
        UsageError: it is neither.
        UntrustedError: the zip is broken or a bomb.
    """
    if path.is_dir():
        return Folder(path)
    if path.is_file():
        if zipfile.is_zipfile(path):
            return Zip(path)
        with path.open("rb") as file:
            if file.read(len(_ZIP)) == _ZIP:
                raise UntrustedError(
                    "a zip that is cut off: the list of its files, which is at its end, is missing",
                    file=path,
                    remedy="copy it again, or pack it again",
                )
    raise UsageError("neither a folder nor a zip", file=path, expected="a submission: renders and manifest.json")


class Folder:
    """A folder; links and devices in it are refused by name, not followed.

    Attributes:
        where: its path.
        sizes: bytes of each regular file.
        refused: why, of what is no regular file.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self.where = str(root)
        self.sizes: dict[str, int] = {}
        self.refused: dict[str, str] = {}
        for count, (path, found) in enumerate(_walk(root, "", 0)):
            if count >= MAX_ENTRIES:
                raise UntrustedError(f"more than {MAX_ENTRIES:,} files", file=root, expected="a submission")
            if isinstance(found, str):
                self.refused[path] = found
            else:
                self.sizes[path] = found

    def read(self, path: str, max_bytes: int) -> bytes:
        """See `UntrustedFiles`."""
        place = self._root / path
        try:
            # Another process may have put a link or a pipe where a file was listed.
            number = os.open(place, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise UntrustedError(f"cannot be read: {error.strerror}", file=place) from error
        with os.fdopen(number, "rb") as file:
            if not stat.S_ISREG(os.fstat(number).st_mode):
                raise UntrustedError("no regular file", file=place)
            data = file.read(max_bytes + 1)
        return _within(data, max_bytes, str(place))


class Zip:
    """A zip, read in place.

    Attributes:
        where: its path.
        sizes: bytes of each file, as the archive says; more are never read.
        refused: why, of what is no plain file.
    """

    def __init__(self, path: Path) -> None:
        self.where = str(path)
        self.sizes: dict[str, int] = {}
        self.refused: dict[str, str] = {}
        try:
            self._archive = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError, ValueError) as error:
            raise UntrustedError(f"not a whole zip ({error})", file=path) from error
        entries = self._archive.infolist()
        if len(entries) > MAX_ENTRIES:
            raise UntrustedError(f"more than {MAX_ENTRIES:,} files", file=path, expected="a submission")
        for entry in entries:
            if entry.is_dir():
                continue
            why = _refused_entry(entry) or ("twice in the archive" if entry.filename in self.sizes else None)
            if why is None:
                self.sizes[entry.filename] = entry.file_size
            else:
                self.refused[entry.filename] = why

    def read(self, path: str, max_bytes: int) -> bytes:
        """See `UntrustedFiles`."""
        place = f"{self.where}: {path}"
        try:
            with self._archive.open(path) as file:
                data = file.read(max_bytes + 1)
        except (zipfile.BadZipFile, OSError, ValueError, EOFError, NotImplementedError, RuntimeError) as error:
            raise UntrustedError(f"cannot be read ({error})", file=place) from error
        return _within(data, max_bytes, place)

    def __reduce__(self) -> tuple[type[Zip], tuple[Path]]:
        return (Zip, (Path(self.where),))


def parse_untrusted(data: bytes, file: str, max_bytes: int) -> Any:
    """A JSON value of bytes that nobody vouches for.

    Raises:
        UntrustedError: it is too large, no JSON, nested too deep, or has a key twice in an object or a
            number that JSON does not have.
    """
    _within(data, max_bytes, file)
    try:
        return decode_json(data, constants=False)
    except JsonError as error:
        raise UntrustedError(f"{error!s:.240}", file=file, place=error.place, expected="JSON") from error


def _walk(folder: Path, prefix: str, depth: int) -> Iterator[tuple[str, int | str]]:
    """Paths below a folder, each with its size, or why it is refused."""
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda one: one.name):
            path = f"{prefix}{entry.name}"
            if entry.is_symlink():
                yield path, "a link"
            elif entry.is_dir(follow_symlinks=False):
                if depth >= _MOST_DEPTH:
                    yield path, f"a folder {_MOST_DEPTH} deep"
                else:
                    yield from _walk(Path(entry.path), f"{path}/", depth + 1)
            elif entry.is_file(follow_symlinks=False):
                yield path, entry.stat(follow_symlinks=False).st_size
            else:
                yield path, "no regular file"


def _refused_entry(entry: zipfile.ZipInfo) -> str | None:
    name, mode = entry.filename, entry.external_attr >> 16
    if name.startswith("/") or "\\" in name or ":" in name or any(part in ("", ".", "..") for part in name.split("/")):
        return "its path leads out of the archive, or is none"
    if mode and not stat.S_ISREG(mode) and stat.S_IFMT(mode):
        return "a link or no regular file"
    if entry.flag_bits & 0x1:
        return "encrypted"
    if entry.file_size > _RATIO_FROM_BYTES and entry.file_size > _MOST_RATIO * max(entry.compress_size, 1):
        return f"more than {_MOST_RATIO} times as large as it is stored"
    return None


def _within(data: bytes, max_bytes: int, file: str) -> bytes:
    if len(data) > max_bytes:
        raise UntrustedError("too large", file=file, expected=f"at most {max_bytes:,} bytes")
    return data
