"""Folders of rendered images: an interrupted run resumes in its own folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mirror.errors import UsageError
from mirror.schema.files import write_bytes
from mirror.schema.folders import FolderKind, require_output_folder

UNFINISHED_MARK: Final = ".rendering"
"""Name of a file in a folder that is not complete: a hash of the settings that decide its files."""


def start_render_folder(out: Path, settings: Sequence[str] | None, *, last: str | None = None) -> None:
    """Require that a folder is new or empty, or holds an interrupted run with the same settings.

    Args:
        out: the folder; it is created.
        settings: the settings that decide the files of the folder; None: an interrupted run is not resumed.
        last: name of the file that is written last; None: there is no such file.

    Raises:
        UsageError: the folder holds other files, a complete submission, or an interrupted run with other settings.
        DatasetError: the folder cannot be written.
    """
    digest = hashlib.sha256(json.dumps(settings).encode()).hexdigest()
    mark = out / UNFINISHED_MARK
    if require_output_folder(out, FolderKind.SUBMISSION) is None:
        if settings is not None:
            write_bytes(mark, digest.encode())
        return
    if last is not None and (out / last).is_file():
        raise UsageError(
            "it holds a submission already", file=out, place="--out", remedy="use it, or name a new folder with --out"
        )
    if settings is None or not mark.is_file():
        raise UsageError("not an empty folder", file=out, place="--out", remedy="name a new one with --out")
    if mark.read_text() != digest:
        raise UsageError(
            "it holds an interrupted run with other settings",
            file=out,
            place="--out",
            remedy="name a new one with --out",
        )


def finish_render_folder(out: Path) -> None:
    """Mark a folder as complete."""
    (out / UNFINISHED_MARK).unlink(missing_ok=True)
