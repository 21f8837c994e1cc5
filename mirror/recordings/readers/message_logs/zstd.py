"""Logs that a recorder compressed with Zstandard: whole files (``.db3.zstd``), or single messages.

A whole file is unpacked once a process, beside no recording: into a temporary folder that is removed at its end.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from pathlib import Path
from threading import Lock
from typing import Any, Final

from mirror.errors import RecordingError
from mirror.installation import install_command
from mirror.recordings.opening import unreadable_error
from mirror.recordings.paths import not_a_file_error

SUFFIXES: Final = (".zstd", ".zst")
_MAGIC: Final = b"\x28\xb5\x2f\xfd"
# The largest chunk of an MCAP file that is read, for the same reason: a few bytes may claim any size.
_LARGEST_MESSAGE: Final = 2**30
_unpacked: dict[tuple[str, int, int], Path] = {}
_folders: list[str] = []
_lock = Lock()


def without_suffix(path: Path) -> Path:
    """Return the path without the suffix of a compressed file."""
    return path.with_suffix("") if path.suffix.lower() in SUFFIXES else path


def stored_file(path: Path) -> Path:
    """Return the file to open for a log: the log itself, or the unpacked copy of a compressed log.

    Raises:
        RecordingError: the file is missing, not a regular file, or cannot be unpacked; or the extra is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        return path
    try:
        if not path.is_file():
            raise not_a_file_error(path) if path.exists() else unreadable_error(path, FileNotFoundError())
        status = path.stat()
    except OSError as error:
        raise unreadable_error(path, error) from error
    key = str(path.resolve()), status.st_size, status.st_mtime_ns
    with _lock:
        if key not in _unpacked:
            _unpacked[key] = _unpack(path)
        return _unpacked[key]


def plain_message(data: bytes, path: Path) -> bytes:
    """Return the bytes of a message in CDR, unpacked if the recorder compressed single messages.

    A CDR message begins with the byte 0, and so never with the mark of Zstandard.

    Raises:
        ValueError: the bytes cannot be unpacked, or are beyond 1 GiB.
    """
    if not data.startswith(_MAGIC):
        return data
    zstandard = _import_zstandard(path)
    out = bytearray()
    try:
        for part in zstandard.ZstdDecompressor().read_to_iter(data):
            out += part
            if len(out) > _LARGEST_MESSAGE:
                raise ValueError(f"it is larger than {_LARGEST_MESSAGE} bytes unpacked")
    except zstandard.ZstdError as error:
        raise ValueError(f"its Zstandard compression is damaged: {error}") from error
    if not out:
        raise ValueError("its Zstandard compression is cut short")
    return bytes(out)


def _unpack(path: Path) -> Path:
    zstandard = _import_zstandard(path)
    if not _folders:
        atexit.register(_remove_folders)
    _folders.append(tempfile.mkdtemp(prefix="mirror-log-"))
    target = Path(_folders[-1]) / without_suffix(path).name
    try:
        with path.open("rb") as packed, target.open("wb") as out:
            zstandard.ZstdDecompressor().copy_stream(packed, out)
    except (zstandard.ZstdError, OSError) as error:
        target.unlink(missing_ok=True)
        raise RecordingError(
            f"cannot be unpacked ({error})",
            file=path,
            expected="a file that Zstandard compressed, and space for it in the temporary folder",
            remedy="copy it again, or unpack it: `zstd -d`",
        ) from error
    return target


def _remove_folders() -> None:
    for folder in _folders:
        shutil.rmtree(folder, ignore_errors=True)


def _import_zstandard(path: Path) -> Any:
    try:
        import zstandard
    except ImportError as error:
        raise RecordingError(
            "compressed logs need the packages of the extra mcap", file=path, remedy=install_command("mcap")
        ) from error
    return zstandard
