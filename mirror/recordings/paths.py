"""Lists and checks the file names of a recording: none may lead out of it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
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
    """Return the path of a file that a recording names, and require that the path lies inside the recording.

    Args:
        root: the recording's folder.
        name: a relative path with forward slashes, as written in one of the recording's files.
        file: the file that holds the name, for the message.
        place: the place of the name in that file, for the message.

    Raises:
        RecordingError: the name is absolute, contains ``..``, or leads outside through a link.
    """
    parts = PurePosixPath(name).parts
    windows = PureWindowsPath(name)
    climbs = not parts or ".." in parts or "\0" in name
    if climbs or name.startswith("/") or "\\" in name or windows.drive:
        raise _outside_error(name, file, place)
    path = root / name
    try:
        target = path.resolve()
    except (OSError, RuntimeError) as error:
        # For a circle of links the system raises an OSError and pathlib a RuntimeError.
        raise RecordingError(
            f"{name!r} cannot be followed ({error})",
            file=file,
            place=place,
            expected="a file, or a link to one inside the recording's folder",
            remedy="remove the link, or put the file in its place",
        ) from error
    if not target.is_relative_to(root.resolve()):
        raise _outside_error(name, file, place)
    return path


def require_files_inside(root: Path, names: Sequence[str], *, file: Path) -> list[Path]:
    """Return the paths of many files that a recording names, resolving each folder once; see `require_inside`.

    Args:
        root: the recording's folder.
        names: relative paths with forward slashes.
        file: the file that holds the names, for the message.

    Raises:
        RecordingError: as `require_inside`; the name is the place.
    """
    followed: set[str] = set()
    prefix = f"{root}{os.sep}"
    paths = []
    for name in names:
        folder, _, last = name.rpartition("/")
        plain = last not in ("", ".", "..") and not any(letter in name for letter in "\\\0:")
        if plain and folder and folder not in followed:
            require_inside(root, folder, file=file, place=name)
            followed.add(folder)
        path = prefix + name
        if not plain or name.startswith("/") or os.path.islink(path):  # noqa: PTH114
            require_inside(root, name, file=file, place=name)
        paths.append(Path(path))
    return paths


def _outside_error(name: str, file: Path, place: str) -> RecordingError:
    return RecordingError(
        f"{name!r} leads out of the recording",
        file=file,
        place=place,
        expected="a relative path without '..' to a file inside the recording's folder",
        remedy="copy the file into the recording and name it there",
    )


def not_a_file_error(path: Path) -> RecordingError:
    """Make the error for a folder, pipe, socket or device in place of a file."""
    return RecordingError(
        "is no plain file: a folder, pipe or device, or a link to nothing",
        file=path,
        expected="a file",
        remedy="put the file in its place, or remove it",
    )


def is_remote_uri(uri: str) -> bool:
    """Return whether a uri is absolute and on another machine: no local scheme, no ``..``, no chain with ``::``."""
    return (
        _SCHEME.match(uri) is not None
        and uri.partition("://")[0] not in _LOCAL
        and "::" not in uri
        and ".." not in PurePosixPath(uri).parts
    )


def list_folder(root: Path, folder: Path) -> dict[str, Path]:
    """Return the regular files of one folder, by name; see `list_file_names`."""
    return {name: folder / name for name in list_file_names(root, folder)}


def list_file_names(root: Path, folder: Path) -> list[str]:
    """List the names of the regular files of one folder, without hidden ones.

    Args:
        root: the recording's folder.
        folder: a folder inside it.

    Raises:
        RecordingError: the folder or an entry is a link that leads out of the recording, or an entry is a pipe, a
            device or a link to nothing.
    """
    if folder != root:
        require_inside(root, folder.relative_to(root).as_posix(), file=folder, place="folder")
    names = []
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            if name.startswith("."):
                continue
            if entry.is_symlink():
                path = folder / name
                require_inside(root, path.relative_to(root).as_posix(), file=path, place="link")
            if entry.is_file():
                names.append(name)
            elif not entry.is_dir():
                raise not_a_file_error(folder / name)
    return names


def list_files(root: Path) -> list[tuple[str, str]]:
    """List every file under a folder, without hidden ones, as ``(relative path, path)`` in the order of relative paths.

    The paths are strings, not `Path` objects: a recording may have a hundred thousand images, and most are not opened.

    Args:
        root: a recording's folder.

    Raises:
        RecordingError: a link leads out of the recording or to nothing, or an entry is a pipe or device.
    """
    files: list[tuple[str, str]] = []
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
                # A linked folder lies inside the recording and is listed under its own name.
                if entry.is_dir(follow_symlinks=False):
                    open_folders.append((relative + "/", path))
                elif entry.is_file():
                    files.append((relative, path))
                elif not entry.is_dir():
                    raise not_a_file_error(Path(path))
    return sorted(files)


def natural_key(name: str) -> tuple[str | int, ...]:
    """Return a sort key that compares numbers in names by value.

    ``part_9.csv`` comes before ``part_10.csv``.
    """
    return tuple(int(part) if index % 2 else part for index, part in enumerate(_DIGITS.split(name)))


def to_identifier(text: str) -> str:
    """Convert any text to a valid id: invalid characters become ``_``, and the length is at most 120 characters.

    Raises:
        RecordingError: the text has no letter or digit.
    """
    cleaned = re.sub(r"[^A-Za-z0-9_\-]", "_", text).lstrip("_-")[:120]
    if not cleaned:
        raise RecordingError(f"{text!r} has no letter or digit for an id", expected="letters, digits, '_' and '-'")
    return cleaned
