"""File names of a recording: listed fast, ordered as a person counts, and never leading out of it."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath, PureWindowsPath

from mirror.errors import RecordingError

_DIGITS = re.compile(r"(\d+)")
_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*://.")
# fmt: off
_LOCAL = frozenset((
    "file", "local", "asynclocal", "async_wrapper", "asyncwrapper", "generic", "reference", "git", "dvc",
    "dir", "data", "zip", "tar", "libarchive", "cached", "blockcache", "filecache", "simplecache",
))
# fmt: on


def require_inside(root: Path, name: str, *, file: Path, place: str) -> Path:
    """The file that a recording names, if it lies inside the recording.

    Args:
        root: the recording's folder.
        name: a relative path with forward slashes, as written in one of the recording's files.
        file: the file that names it, for the message.
        place: where in that file.

    Raises:
        RecordingError: the name is absolute, climbs with ``..``, or leads out through a link.
    """
    parts = PurePosixPath(name).parts
    windows = PureWindowsPath(name)
    climbs = not parts or ".." in parts or "\0" in name
    if climbs or name.startswith("/") or "\\" in name or windows.drive:
        raise _outside(name, file, place)
    path = root / name
    try:
        found = path.resolve()
    except (OSError, RuntimeError) as error:
        # Links in a circle: the system's word is an OSError, pathlib's a RuntimeError.
        raise RecordingError(
            f"{name!r} cannot be followed ({error})",
            file=file,
            place=place,
            expected="a file, or a link to one inside the recording's folder",
            remedy="remove the link, or put the file in its place",
        ) from error
    if not found.is_relative_to(root.resolve()):
        raise _outside(name, file, place)
    return path


def _outside(name: str, file: Path, place: str) -> RecordingError:
    return RecordingError(
        f"{name!r} leads out of the recording",
        file=file,
        place=place,
        expected="a relative path without '..' to a file inside the recording's folder",
        remedy="copy the file into the recording and name it there",
    )


def not_a_file_error(path: Path) -> RecordingError:
    """The error for a folder, pipe, socket or device where a file belongs."""
    return RecordingError(
        "is no plain file: a folder, pipe or device, or a link to nothing",
        file=path,
        expected="a file",
        remedy="put the file in its place, or remove it",
    )


def is_remote_uri(uri: str) -> bool:
    """Whether a uri is absolute and leads away from this machine's files: no path climbs, no chain hides one."""
    return (
        _SCHEME.match(uri) is not None
        and uri.partition("://")[0] not in _LOCAL
        and "::" not in uri
        and ".." not in PurePosixPath(uri).parts
    )


def list_folder(root: Path, folder: Path) -> dict[str, Path]:
    """The plain files of one folder by name; see `list_file_names`."""
    return {name: folder / name for name in list_file_names(root, folder)}


def list_file_names(root: Path, folder: Path) -> list[str]:
    """Names of the plain files of one folder, hidden ones left out; links are followed only inside the recording.

    Args:
        root: the recording's folder.
        folder: a folder inside it.

    Raises:
        RecordingError: the folder or an entry is a link that leads out of the recording, or an entry is a pipe, a
            device or a link to nothing.
    """
    if folder != root:
        require_inside(root, folder.relative_to(root).as_posix(), file=folder, place="folder")
    found = []
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            if name.startswith("."):
                continue
            if entry.is_symlink():
                path = folder / name
                require_inside(root, path.relative_to(root).as_posix(), file=path, place="link")
            if entry.is_file():
                found.append(name)
            elif not entry.is_dir():
                raise not_a_file_error(folder / name)
    return found


def list_files(root: Path) -> list[tuple[str, str]]:
    """Every file under a folder, hidden ones left out, as ``(path relative to it, path)``, in the order of the former.

    Plain strings: of a recording's hundred thousand pictures, most are never opened.

    Args:
        root: a recording's folder.

    Raises:
        RecordingError: a link leads out of the recording or to nothing, or there is a pipe or device.
    """
    found: list[tuple[str, str]] = []
    open_folders = [("", str(root))]
    while open_folders:
        prefix, folder = open_folders.pop()
        with os.scandir(folder) as entries:
            for entry in entries:
                relative, path = prefix + entry.name, entry.path
                if entry.name.startswith("."):
                    continue
                if entry.is_symlink():
                    require_inside(root, relative, file=Path(path), place="link")
                # The folder that a link stands for lies inside and is met under its own name.
                if entry.is_dir(follow_symlinks=False):
                    open_folders.append((relative + "/", path))
                elif entry.is_file():
                    found.append((relative, path))
                elif not entry.is_dir():
                    raise not_a_file_error(Path(path))
    return sorted(found)


def natural_key(name: str) -> tuple[str | int, ...]:
    """Sorts numbers within names by value: ``2`` before ``10``, ``part_9.csv`` before ``part_10.csv``."""
    return tuple(int(part) if index % 2 else part for index, part in enumerate(_DIGITS.split(name)))


def to_identifier(text: str) -> str:
    """A valid id made of any text: other characters become ``_``; at most 120 characters.

    Raises:
        RecordingError: nothing is left.
    """
    cleaned = re.sub(r"[^A-Za-z0-9_\-]", "_", text).lstrip("_-")[:120]
    if not cleaned:
        raise RecordingError(
            f"{text!r} has no letter or digit to make an id of", expected="letters, digits, '_' and '-'"
        )
    return cleaned
