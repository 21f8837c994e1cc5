"""Formats that keep several drives in one folder: a drive has the path ``FOLDER/NAME``, which need not exist."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mirror.errors import RecordingError


def choose_drive(names: Sequence[str], name: str | None, folder: Path) -> str:
    """Return the drive of a folder that has the given name, or the folder's only drive.

    Args:
        names: the folder's drives.
        name: the last part of the path; None: the path is the folder itself, which must then hold one drive.
        folder: the folder.

    Raises:
        RecordingError: there is no such drive, or no name but several drives.
    """
    if name is None and len(names) == 1:
        return names[0]
    if name in names:
        return str(name)
    listed = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    if not names:
        raise RecordingError("the folder holds no drive", file=folder, expected="at least one")
    raise RecordingError(
        f"the folder holds {len(names)} drives" if name is None else f"the folder has no drive {name!r:.80}",
        file=folder,
        expected=f"one of {listed}",
        remedy=f"name one, as in {folder / names[0]}; `mirror ingest {folder}` takes all",
    )


def one_of(options: Mapping[str, str], name: str, values: Sequence[str], path: Path) -> str:
    """Return the value of an option, by default the first of the allowed values.

    Raises:
        RecordingError: the option has another value.
    """
    value = options.get(name, values[0])
    if value not in values:
        raise RecordingError(f"{name}={value!r:.80}", file=path, place=f"option {name}", expected=" or ".join(values))
    return value
