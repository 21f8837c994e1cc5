"""``synth.json`` beside the recordings: their arguments and the complete recordings, so that a run can resume."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import Document
from mirror.schema.files import TEMPORARY, read_json, unwritable_error, write_json
from mirror.schema.folders import FolderKind, require_output_folder

SYNTH: Final = "synth.json"
SECRET_SEED: Final = "secret"
"""Argument ``seed`` of recordings with a secret seed, which stands in another file."""


class Counts(Document):
    """The counts of one written recording.

    Attributes:
        pictures: number of images written or referred to.
        lost: number of images that were lost.
        boxes: number of boxes.
        unseen: number of nearby road users, over all instants, that have no box because no image shows them.
    """

    pictures: int = 0
    lost: int = 0
    boxes: int = 0
    unseen: int = 0


class SynthDocument(Document):
    """``synth.json``: the arguments and the drives of a folder of `mirror synth`.

    Attributes:
        format: always ``mirror-synth``.
        version: version of this document's format.
        arguments: all arguments that determine the files, as text.
        drives: counts of the complete recordings, by drive id.
    """

    format: Literal["mirror-synth"] = "mirror-synth"
    version: Literal["1.0"] = "1.0"
    arguments: dict[str, str]
    drives: dict[str, Counts] = Field(default_factory=dict)


class Journal:
    """A journal of the complete recordings of a folder; see `open_journal`."""

    def __init__(self, out: Path, document: SynthDocument) -> None:
        self._out, self._document = out, document

    @property
    def is_new(self) -> bool:
        """Return whether the folder holds the journal alone, as no recording was begun."""
        return not self._document.drives and not any(path.name != SYNTH for path in self._out.iterdir())

    def find_complete(self, drive_id: str) -> Counts | None:
        """Return the counts of a complete recording; otherwise remove its incomplete files and return None."""
        folder = self._out / drive_id
        counts = self._document.drives.get(drive_id)
        if counts is not None and (folder / "recording.json").is_file():
            return counts
        if folder.exists():
            shutil.rmtree(folder)
        return None

    def add(self, drive_id: str, counts: Counts) -> None:
        """Record that a recording is complete."""
        drives = {**self._document.drives, drive_id: counts}
        self._document = self._document.model_copy(update={"drives": drives})
        write_json(self._out / SYNTH, self._document)


@contextmanager
def open_journal(out: Path, arguments: dict[str, str]) -> Iterator[Journal]:
    """Lock a folder of recordings for this process while the block runs.

    Args:
        out: a new or an empty folder, or one with an unfinished run of the same arguments.
        arguments: all arguments that determine the files.

    Raises:
        UsageError: the folder holds other files, or recordings of other arguments.
        DatasetError: another run is writing to the folder, or the folder cannot be written.
    """
    there = require_output_folder(out, FolderKind.RECORDINGS)
    if there is not None and not (out / SYNTH).is_file():
        raise UsageError(
            "it holds recordings that `mirror synth` did not write: nothing was written",
            file=out,
            place="--out",
            expected="a new or an empty folder",
            remedy="name another folder with --out",
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable_error(out / SYNTH, error) from error
    with _lock(out):
        document = read_json(out / SYNTH, SynthDocument) if (out / SYNTH).is_file() else None
        if document is not None and document.arguments != arguments:
            differing = sorted(key for key in arguments if document.arguments.get(key) != arguments[key])
            raise UsageError(
                f"it holds recordings made with another {', '.join(map(_flag, differing))}: nothing was written",
                file=out,
                place="--out",
                expected="a new or an empty folder, or recordings of the same arguments",
                remedy="name another folder with --out",
            )
        for left in out.glob(f".*{TEMPORARY}"):
            left.unlink()
        if document is None:
            document = SynthDocument(arguments=arguments)
            write_json(out / SYNTH, document)
        yield Journal(out, document)


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    # The operating system releases the lock when the process ends for any reason; the lock leaves no file.
    number = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise DatasetError("another run is writing these recordings", file=folder, remedy="let it finish") from error
    finally:
        os.close(number)


def _flag(argument: str) -> str:
    """Return the option of `mirror synth` for an argument."""
    names = {"toolkit": "version of the toolkit", "effects": "--without", "seed": "--seed or --secret"}
    return names.get(argument, f"--{argument}")
