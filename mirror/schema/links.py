"""Links in a folder that lead out of it: whoever walks the folder refuses them, on read and on write.

A link to another place of the same folder is followed, and the folder itself may be a link. `require_inside` tests one
path; `refuse_links_out` tests everything below a folder, without opening a file.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

from mirror.errors import DatasetError

_MAX_PART: Final = 255
_MAX_PATH: Final = 4095


def require_inside(root: Path, path: str | Path) -> Path:
    """Require that no link between a folder and a path below it leads out of the folder.

    Args:
        root: the folder.
        path: relative to it; it need not exist.

    Returns:
        The path below the folder.

    Raises:
        DatasetError: the path leads out of the folder, by a link or by ``..``, or no file system has such a name.
    """
    if not is_file_name(path):
        raise DatasetError(
            f"{str(path)[:40]!r}... is no name of a file",
            file=root,
            expected=f"a path without NUL, of at most {_MAX_PART} bytes in a part and {_MAX_PATH} in all",
        )
    place = root / path
    if not _has_link(root, path):
        return place
    target = os.path.realpath(place)
    if not _is_below(target, os.path.realpath(root)):
        raise _leads_out_error(place, target)
    return place


def is_file_name(path: str | Path) -> bool:
    """Return whether a file system can hold a path: no NUL, at most 255 bytes per part and 4095 in all."""
    data = os.fsencode(path)
    return b"\0" not in data and len(data) <= _MAX_PATH and max(map(len, data.split(b"/"))) <= _MAX_PART


def refuse_links_out(root: Path) -> None:
    """Refuse a folder in which a link leads out of it.

    Args:
        root: the folder; nothing happens if it does not exist.

    Raises:
        DatasetError: a link leads out; it is named.
    """
    inside = os.path.realpath(root)
    waiting = [os.fspath(root)]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as entries:
                listed = list(entries)
        except (FileNotFoundError, NotADirectoryError):
            continue
        for entry in listed:
            if entry.is_symlink():
                target = os.path.realpath(entry.path)
                if not _is_below(target, inside):
                    raise _leads_out_error(entry.path, target)
            elif entry.is_dir():
                waiting.append(entry.path)


def _has_link(root: Path, path: str | Path) -> bool:
    """Return whether a part of a path below a folder is a link, or goes up."""
    place = os.fspath(root)
    parts = Path(path).parts
    if ".." in parts:
        return True
    for part in parts:
        place = f"{place}/{part}"
        try:
            if stat.S_ISLNK(os.lstat(place).st_mode):
                return True
        except OSError:
            # What does not exist has no link in it; whoever opens it reports what is missing.
            return False
    return False


def _is_below(path: str, folder: str) -> bool:
    return path == folder or path.startswith(f"{folder.rstrip('/')}/")


def _leads_out_error(place: str | Path, target: str) -> DatasetError:
    return DatasetError(
        f"it leads out of its folder, to {target}",
        file=place,
        expected="files and folders of their own, or links to others in the same folder",
        remedy="put a copy in place of the link, or remove it",
    )
