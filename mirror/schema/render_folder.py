"""Folders of rendered images that an interrupted run goes on with."""

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
"""In a folder whose files are not all there yet: a hash of what they are of."""


def start_render_folder(out: Path, of: Sequence[str] | None, *, last: str | None = None) -> None:
    """See that a folder is new or empty, or that the same work was interrupted in it.

    Args:
        out: the folder; it is made.
        of: what decides its files; None: nothing goes on.
        last: name of the file that is written last; None: there is none.

    Raises:
        UsageError: it holds something else.
        DatasetError: it cannot be written.
    """
    mark = hashlib.sha256(json.dumps(of).encode()).hexdigest()
    begun = out / UNFINISHED_MARK
    if require_output_folder(out, FolderKind.SUBMISSION) is None:
        if of is not None:
            write_bytes(begun, mark.encode())
        return
    if last is not None and (out / last).is_file():
        raise UsageError(
            "a submission is there already", file=out, place="--out", remedy="take it, or name a new folder with --out"
        )
    if of is None or not begun.is_file():
        raise UsageError("not an empty folder", file=out, place="--out", remedy="name a new one with --out")
    if begun.read_text() != mark:
        raise UsageError(
            "renders of something else began here", file=out, place="--out", remedy="name a new one with --out"
        )


def finish_render_folder(out: Path) -> None:
    """Note that all files of a folder are there."""
    (out / UNFINISHED_MARK).unlink(missing_ok=True)
