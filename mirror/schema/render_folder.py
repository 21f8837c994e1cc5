"""Folders of rendered images: an interrupted run resumes in its own folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from mirror.errors import UsageError
from mirror.schema.files import remove_temporaries, write_bytes
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.hashing import hash_document

UNFINISHED_MARK: Final = ".rendering"
"""Name of a file in a submission that is not complete: a hash of the settings that decide its files."""
_MARKS: Final[Mapping[FolderKind, str]] = {
    FolderKind.SUBMISSION: UNFINISHED_MARK,
    FolderKind.GENERATED: ".generating",
    FolderKind.CLIPS: ".making-clips",
}


def start_render_folder(
    out: Path, settings: Sequence[str] | None, *, last: str | None = None, kind: FolderKind = FolderKind.SUBMISSION
) -> None:
    """Require that a folder is new or empty, or holds an interrupted run with the same settings.

    Args:
        out: the folder; it is created.
        settings: the settings that decide the files of the folder; None: an interrupted run is not resumed.
        last: name of the file that is written last; None: there is no such file.
        kind: what the folder becomes, such as a submission or a generated scene.

    Raises:
        UsageError: the folder holds other files, a complete result of this kind, or an interrupted run with other
            settings.
        DatasetError: the folder cannot be written.
    """
    digest = hash_document(settings)
    mark = out / _MARKS[kind]
    if require_output_folder(out, kind) is None:
        if settings is not None:
            write_bytes(mark, digest.encode())
        return
    if last is not None and (out / last).is_file():
        raise UsageError(
            f"it holds {kind.value} already", file=out, place="--out", remedy="use it, or name a new folder with --out"
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
    remove_temporaries(out)


def finish_render_folder(out: Path, kind: FolderKind = FolderKind.SUBMISSION) -> None:
    """Mark a folder as complete."""
    (out / _MARKS[kind]).unlink(missing_ok=True)
