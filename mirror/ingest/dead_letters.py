"""Recordings that could not be ingested, kept in the dataset as Parquet for `mirror ingest --retry-failed`.

Each run that had failures writes one file, named by its content. A run removes the files whose recordings it has all
tried again: what failed once more is in its own file. So runs at the same time lose nothing of each other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import pyarrow as pa

from mirror.schema.commit import commit_bytes
from mirror.schema.files import encode_table, read_table
from mirror.schema.tables import Table, column

FOLDER: Final = "failures"

DEAD_LETTERS: Final = Table(
    name="dead_letters",
    row="one recording that a run could not ingest",
    place="failures/<sha256>.parquet",
    schema=pa.schema(
        [
            column("recording", pa.string(), "Its path, absolute, on the machine of the run."),
            column("status", pa.string(), "`failed`: an error; `crashed`: its process ended; `hung`: too slow."),
            column("error", pa.string(), "Class of the error."),
            column("problem", pa.string(), "The error in words."),
            column("attempts", pa.int32(), "Number of attempts."),
        ]
    ),
    sorted_by=("recording",),
)


@dataclass(frozen=True)
class DeadLetter:
    """A recording that could not be ingested.

    Attributes:
        recording: its path, absolute.
        status: `failed`, `crashed` or `hung`.
        error: class of the error.
        problem: the error in words.
        attempts: number of attempts.
    """

    recording: str
    status: str
    error: str
    problem: str
    attempts: int


def list_dead_letters(root: Path) -> list[Path]:
    """List the files of dead letters of a dataset, sorted."""
    return sorted((root / FOLDER).glob("*.parquet"))


def read_dead_letters(files: Sequence[Path]) -> list[DeadLetter]:
    """Read dead letters; of a recording that has several, one is returned.

    Raises:
        SchemaError: a file is broken.
    """
    rows = [row for file in files for row in read_table(file, DEAD_LETTERS).to_pylist()]
    letters = {row["recording"]: DeadLetter(**row) for row in rows}
    return [letters[name] for name in sorted(letters)]


def write_dead_letters(root: Path, letters: Collection[DeadLetter], retried: Sequence[Path] = ()) -> Path | None:
    """Write the dead letters of a run, and remove those that it retried.

    Args:
        root: folder of the dataset.
        letters: recordings that failed; without any, no file is written.
        retried: files whose recordings this run tried again.

    Returns:
        The file; None: there is none.

    Raises:
        UnwritableError: it cannot be written.
    """
    written = None
    if letters:
        rows = [asdict(one) for one in sorted(letters, key=lambda one: one.recording)]
        data = encode_table(pa.Table.from_pylist(rows, schema=DEAD_LETTERS.schema), DEAD_LETTERS)
        written = root / FOLDER / f"{hashlib.sha256(data).hexdigest()[:16]}.parquet"
        commit_bytes(written, data)
    for file in retried:
        if file != written:
            file.unlink(missing_ok=True)
    with suppress(OSError):
        (root / FOLDER).rmdir()
    return written
