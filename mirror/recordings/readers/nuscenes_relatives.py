"""Datasets that have the 13 tables of nuScenes but other contents: they are named, and not read as nuScenes.

Lyft Level 5 (perception, versions 1.01 and 1.02) has stamps as fractions of microseconds and images in ``images``. The
T4 format of TIER IV has its tables in ``annotation``, images in ``data`` and frames of its own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from mirror.errors import MirrorError, RecordingError
from mirror.recordings.opening import find_file, read_json

FOLDERS_OF_RELATIVES: Final = ("data", "train_data", "test_data", "annotation")
"""Folders in which these datasets keep their tables."""
# Sensors that the vehicles of Lyft have and those of nuScenes do not.
_LYFT_SENSORS: Final = {"CAM_FRONT_ZOOMED", "LIDAR_FRONT_LEFT", "LIDAR_FRONT_RIGHT"}
_LYFT_VERSIONS: Final = ("v1.01", "v1.02")
_T4_FOLDER: Final = "annotation"


def refuse_relatives(root: Path, folder: Path) -> None:
    """Refuse a folder of tables in nuScenes' style that belongs to another dataset.

    Args:
        root: the folder of the sensors' files.
        folder: the folder of the tables.

    Raises:
        RecordingError: naming the dataset.
    """
    name = folder.resolve().name
    if name.startswith(_LYFT_VERSIONS) or _LYFT_SENSORS & _values(root, folder, "sensor", "channel"):
        raise _error("the Lyft Level 5 perception dataset", folder)
    if any("palo_alto" in text for text in _values(root, folder, "map", "filename")):
        raise _error("the Lyft Level 5 perception dataset", folder)
    if name == _T4_FOLDER:
        raise _error("a dataset in the T4 format of TIER IV", folder)


def _values(root: Path, folder: Path, table: str, key: str) -> set[str]:
    """The texts of one key of a small table; nothing where the table is missing or broken, which others report."""
    prefix = "" if folder == root else f"{folder.relative_to(root).as_posix()}/"
    try:
        file = find_file(root, f"{prefix}{table}.json")
        rows: Any = [] if file is None else read_json(file)
    except MirrorError:
        return set()
    records = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    return {str(record[key]) for record in records if key in record}


def _error(dataset: str, folder: Path) -> RecordingError:
    return RecordingError(
        f"the tables of {dataset}: they have the names of nuScenes, but other contents",
        file=folder,
        expected="the tables of nuScenes v1.0",
        remedy="no reader reads this dataset: convert it to MIRROR's own layout (docs/recordings/folder.md), or install"
        " a package that reads it",
    )
