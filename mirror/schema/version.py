"""The version of the on-disk format, and the check of stored versions."""

from __future__ import annotations

from pathlib import PurePath
from typing import Final

from mirror.errors import SchemaError
from mirror.installation import upgrade_command

SCHEMA_VERSION: Final = "1.1.0"
DATASET_VERSION: Final = "1.2.0"
"""Version of ``dataset.json`` alone: datasets before it have an index without snapshots."""


def require_readable(stored: object, file: str | PurePath, newest: str = SCHEMA_VERSION) -> None:
    """Refuse a schema version that this toolkit cannot read.

    A version is readable if its major number is the same and its minor number is not greater (semver).

    Args:
        stored: the version string as stored.
        file: the file that holds it, for the message.
        newest: the newest version that is readable.

    Raises:
        SchemaError: the version is not readable; file, both versions and the remedy are named.
    """
    ours = tuple(int(part) for part in newest.split("."))
    try:
        theirs = tuple(int(part) for part in str(stored).split("."))
    except ValueError:
        theirs = ()
    if len(theirs) != 3:
        raise SchemaError(
            f"schema version {stored!r} is not a version",
            file=file,
            place="schema_version",
            expected=f"three numbers such as {newest}",
            remedy="restore the file from a backup or ingest the recordings again into a new folder",
        )
    if theirs[:2] > ours[:2]:
        raise SchemaError(
            f"schema version {stored} is newer than this toolkit's",
            file=file,
            place="schema_version",
            expected=f"at most {ours[0]}.{ours[1]}.x",
            remedy=f"upgrade the toolkit: {upgrade_command()}",
        )
    if theirs[0] < ours[0]:
        raise SchemaError(
            f"schema version {stored} is older than this toolkit reads",
            file=file,
            place="schema_version",
            expected=f"{ours[0]}.x.x",
            remedy="ingest the recordings again into a new folder, or read it with the toolkit that wrote it",
        )


def require_migrated(stored: str, file: str | PurePath) -> None:
    """Refuse a dataset of an earlier version, whose index has no snapshots.

    Args:
        stored: the version in ``dataset.json``.
        file: that file, for the message.

    Raises:
        SchemaError: the version is earlier than `DATASET_VERSION`; the verb that migrates the dataset is named.
    """
    if [int(part) for part in stored.split(".")[:2]] < [int(part) for part in DATASET_VERSION.split(".")[:2]]:
        raise SchemaError(
            f"a dataset of version {stored}, whose index has no snapshots",
            file=file,
            place="schema_version",
            expected=f"version {DATASET_VERSION}",
            remedy=f"run `mirror dataset migrate {PurePath(file).parent}`; a published dataset is published again",
        )
