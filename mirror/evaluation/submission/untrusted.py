"""Untrusted files: a folder or a zip, listed and read within limits; links and unsafe names are refused.

No archive is unpacked, no link is followed and no file is executed. Names of files are only compared with expected
names.
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
_MAX_DEPTH: Final = 16
_MAX_RATIO: Final = 200
_RATIO_FROM_BYTES: Final = 1 << 20
_ZIP: Final = b"PK\x03\x04"


class UntrustedError(MirrorError):
    """A submission that is refused as a whole."""


class UntrustedFiles(Protocol):
    """The files of a submission.

    Attributes:
        where: path of the submission.
        sizes: path of each regular file within the submission, with its number of bytes.
        refused: path of each refused file, with the reason.
    """

    where: str
    sizes: dict[str, int]
    refused: dict[str, str]

    def read(self, path: str, max_bytes: int) -> bytes:
        """Read the bytes of a listed file.

        Raises:
            UntrustedError: the file is larger than `max_bytes`, or cannot be read.
        """


def open_untrusted(path: Path) -> UntrustedFiles:
    """Open a folder or a zip.

    Raises:
        UsageError: the path is neither.
        UntrustedError: the zip is broken, or has too many files.
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
    """A submission in a folder; links and devices in it are listed as refused and never followed.

    Attributes:
        where: path of the folder.
        sizes: number of bytes of each regular file.
        refused: the reason for each refused file.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self.where = str(root)
        self.sizes: dict[str, int] = {}
        self.refused: dict[str, str] = {}
        for count, (path, size_or_reason) in enumerate(_walk(root, "", 0)):
            if count >= MAX_ENTRIES:
                raise UntrustedError(f"more than {MAX_ENTRIES:,} files", file=root, expected="a submission")
            if isinstance(size_or_reason, str):
                self.refused[path] = size_or_reason
            else:
                self.sizes[path] = size_or_reason

    def read(self, path: str, max_bytes: int) -> bytes:
        """See `UntrustedFiles`."""
        place = self._root / path
        try:
            # Since the listing, another process may have replaced the file by a link or a pipe.
            number = os.open(place, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise UntrustedError(f"cannot be read: {error.strerror}", file=place) from error
        with os.fdopen(number, "rb") as file:
            if not stat.S_ISREG(os.fstat(number).st_mode):
                raise UntrustedError("not a regular file", file=place)
            data = file.read(max_bytes + 1)
        return _require_size(data, max_bytes, str(place))


class Zip:
    """A zip, read in place.

    Attributes:
        where: path of the zip.
        sizes: number of bytes of each file, as the archive states it.
        refused: the reason for each refused entry.
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
            why = _find_refusal(entry) or ("twice in the archive" if entry.filename in self.sizes else None)
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
        return _require_size(data, max_bytes, place)

    def __reduce__(self) -> tuple[type[Zip], tuple[Path]]:
        return (Zip, (Path(self.where),))


def parse_untrusted(data: bytes, file: str, max_bytes: int) -> Any:
    """Parse untrusted bytes as JSON.

    Raises:
        UntrustedError: the data is too large, is not JSON, is nested too deep, repeats a key of an object, or has NaN
            or an infinite number.
    """
    _require_size(data, max_bytes, file)
    try:
        return decode_json(data, constants=False)
    except JsonError as error:
        raise UntrustedError(f"{error!s:.240}", file=file, place=error.place, expected="JSON") from error


def _walk(folder: Path, prefix: str, depth: int) -> Iterator[tuple[str, int | str]]:
    """List the paths below a folder, each with its size or with the reason why it is refused."""
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda item: item.name):
            path = f"{prefix}{entry.name}"
            if entry.is_symlink():
                yield path, "a link"
            elif entry.is_dir(follow_symlinks=False):
                if depth >= _MAX_DEPTH:
                    yield path, f"a folder {_MAX_DEPTH} deep"
                else:
                    yield from _walk(Path(entry.path), f"{path}/", depth + 1)
            elif entry.is_file(follow_symlinks=False):
                yield path, entry.stat(follow_symlinks=False).st_size
            else:
                yield path, "not a regular file"


def _find_refusal(entry: zipfile.ZipInfo) -> str | None:
    name, mode = entry.filename, entry.external_attr >> 16
    if name.startswith("/") or "\\" in name or ":" in name or any(part in ("", ".", "..") for part in name.split("/")):
        return "its path is invalid or leads out of the archive"
    if mode and not stat.S_ISREG(mode) and stat.S_IFMT(mode):
        return "a link, or not a regular file"
    if entry.flag_bits & 0x1:
        return "encrypted"
    if entry.file_size > _RATIO_FROM_BYTES and entry.file_size > _MAX_RATIO * max(entry.compress_size, 1):
        return f"more than {_MAX_RATIO} times its compressed size"
    return None


def _require_size(data: bytes, max_bytes: int, file: str) -> bytes:
    if len(data) > max_bytes:
        raise UntrustedError("too large", file=file, expected=f"at most {max_bytes:,} bytes")
    return data
