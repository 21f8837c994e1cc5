"""Identifies a folder by the documents in it, so that no verb writes into a folder of another kind.

Every verb with an option ``--out`` calls one of two functions before it writes anything:

- `require_output_folder(out, FolderKind.RESULTS)`: ``out`` becomes a folder of that kind. It may be absent, empty, or
  of that kind already; then the verb decides whether to resume, to add to it or to refuse. Without a kind the folder
  must be absent or empty. The function returns the kind of an existing folder, or None.
- `require_output_file(out)`: ``out`` is one file, such as a page or a video.

Both refuse a path inside a dataset, a recording, a submission or hidden truth, because the content of these is hashed
or immutable. The folder of an interrupted run has its kind too: `_KINDS` lists the files that identify it. A verb that
writes a new kind of folder adds a row to `_KINDS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final

from mirror.errors import UsageError
from mirror.schema.files import TEMPORARY
from mirror.schema.links import refuse_links_out
from mirror.schema.strict_json import JsonError, decode_json

_MAX_BYTES: Final = 64 * 1024 * 1024
_DATASET_NAMES: Final = frozenset(
    {"traversals", "drives", "rigs", "splits", "maps", "index", "rois.geojson", ".lock", ".staging", ".superseded"}
)


class FolderKind(Enum):
    """Kinds of folders; the values are words for messages."""

    DATASET = "a dataset"
    BUNDLE = "a published dataset"
    RECORDING = "a recording"
    RECORDINGS = "a folder of recordings"
    SUBMISSION = "a submission"
    GENERATED = "a scene of `mirror generate`"
    CLIPS = "clips of `mirror generate clips`"
    HIDDEN = "hidden truth"
    MODEL = "a reconstructed model"
    RUN = "a training run"
    ROLLOUT = "a rollout of `mirror simulate`"
    SUITE = "drives of a suite of `mirror simulate`"
    EXPORT = "an export of `mirror export`"
    RESULTS = "results of `mirror evaluate`"
    DEMO = "the folder of a demo"
    BOARD = "a leaderboard's folder"
    SITE = "the site of a leaderboard"
    REPORT = "the site of `mirror report`"
    OTHER = "a folder with other files"


@dataclass(frozen=True)
class _Signs:
    """The files that identify a kind of folder.

    Attributes:
        documents: names of JSON files, each with the value of its key ``format``.
        marks: files or folders that identify the kind by their presence, for instance in the folder of an unfinished
            run.
        sealed: no other output may be written inside.
    """

    documents: Mapping[str, str] = field(default_factory=dict)
    marks: tuple[str, ...] = ()
    sealed: bool = False


_KINDS: Final[Mapping[FolderKind, _Signs]] = {
    FolderKind.BUNDLE: _Signs({"bundle.json": "mirror-bundle"}, marks=(".publishing",), sealed=True),
    FolderKind.DATASET: _Signs({"dataset.json": "mirror"}, sealed=True),
    FolderKind.RECORDING: _Signs({"recording.json": "mirror-folder"}, sealed=True),
    FolderKind.RECORDINGS: _Signs({"synth.json": "mirror-synth"}),
    FolderKind.SUBMISSION: _Signs(
        {"manifest.json": "mirror-submission", "views.json": "mirror-views"}, marks=(".rendering",), sealed=True
    ),
    FolderKind.GENERATED: _Signs({"generated.json": "mirror-generated"}, marks=(".generating",)),
    FolderKind.CLIPS: _Signs({"clips.json": "mirror-clips"}, marks=(".making-clips",)),
    FolderKind.HIDDEN: _Signs({"hidden.json": "mirror-hidden-truth"}, sealed=True),
    FolderKind.MODEL: _Signs({"reconstruction.json": "mirror-reconstruction"}),
    FolderKind.RUN: _Signs({"run.json": "mirror-run"}),
    FolderKind.ROLLOUT: _Signs({"run.json": "mirror-rollout"}, marks=(".driving",), sealed=True),
    FolderKind.SUITE: _Signs({"suite.json": "mirror-suite"}),
    FolderKind.EXPORT: _Signs({"export.json": "mirror-export"}, marks=(".exporting",)),
    FolderKind.RESULTS: _Signs({"result.json": "mirror-result"}, marks=("work/scored.jsonl", "work/features")),
    FolderKind.DEMO: _Signs(marks=(".made-by-mirror-demo",)),
    FolderKind.BOARD: _Signs(marks=("entries",)),
    FolderKind.SITE: _Signs(marks=(".made-by-mirror-leaderboard",)),
    FolderKind.REPORT: _Signs(marks=(".made-by-mirror-report",)),
}


def find_kind(folder: Path) -> FolderKind | None:
    """Find the kind of a folder; None: it does not exist or is empty. Temporary files of a killed process do not count.

    A broken document still identifies the folder if its name alone does; the verb that reads it reports the fault.

    Raises:
        UsageError: the path is a file.
    """
    if not folder.is_dir():
        if folder.exists():
            raise UsageError(
                f"cannot be written: {folder} is a file", file=folder, expected="a folder", remedy="name another place"
            )
        return None
    names = {child.name for child in folder.iterdir() if not _is_temporary(child.name)}
    if not names:
        return None
    kind = next((kind for kind, signs in _KINDS.items() if _matches(folder, signs)), None)
    if kind is not None:
        return kind
    if names <= _DATASET_NAMES and names & {"traversals", ".lock", ".staging"}:
        # The first ingest was interrupted: dataset.json is written with the first complete drive.
        return FolderKind.DATASET
    if any((child / "recording.json").is_file() for child in folder.iterdir()):
        return FolderKind.RECORDINGS
    return FolderKind.OTHER


def require_output_folder(out: Path, *kinds: FolderKind, place: str = "--out") -> FolderKind | None:
    """Refuse an output folder of another kind.

    Args:
        out: the folder that a verb will write.
        kinds: the kinds that an existing folder may have; without kinds it must be absent or empty.
        place: the option that names the folder, for messages.

    Returns:
        The kind of an existing folder; None: it is absent or empty.

    Raises:
        UsageError: it is a file, has another kind, or lies inside a sealed folder.
        DatasetError: it has a link that leads out of it.
    """
    _refuse_inside(out, place)
    existing = find_kind(out)
    if existing is None or existing in kinds:
        if existing is not FolderKind.OTHER:
            refuse_links_out(out)
        return existing
    raise UsageError(
        f"it is {existing.value}: nothing was written",
        file=out,
        place=place,
        expected=", or ".join(["a new or an empty folder", *(kind.value for kind in kinds)]),
        remedy=f"name another folder with {place}",
    )


def require_output_file(out: Path, *, place: str = "--out", writer: str | None = None, mark: str = "") -> None:
    """Refuse an output file inside a sealed folder, in place of a folder, or in place of a file of another origin.

    Args:
        out: the file that a verb will write.
        place: the option that names the file, for messages.
        writer: the command that may replace its own files only; None: any file is replaced.
        mark: text that every file of `writer` has.

    Raises:
        UsageError: it is a folder, lies inside a sealed folder, is a file that `writer` did not write, or cannot be
            made there.
    """
    _refuse_inside(out, place)
    if out.is_dir():
        raise UsageError(
            "a folder, not a file",
            file=out,
            place=place,
            expected="the name of a file",
            remedy=f"name a file with {place}",
        )
    if writer is not None and out.is_file() and mark.encode() not in out.read_bytes():
        raise UsageError(
            f"there is a file that `{writer}` did not write: it is not replaced",
            file=out,
            place=place,
            expected=f"a new file, or one that `{writer}` wrote",
            remedy="name another file",
        )


def _refuse_inside(out: Path, place: str) -> None:
    for folder in out.absolute().resolve().parents:
        for kind, signs in _KINDS.items():
            if signs.sealed and _matches(folder, signs):
                raise UsageError(
                    f"it lies inside {folder}, which is {kind.value}: nothing was written",
                    file=out,
                    place=place,
                    expected=f"a place outside of {kind.value}",
                    remedy=f"name another place with {place}",
                )


def _matches(folder: Path, signs: _Signs) -> bool:
    if any((folder / mark).exists() for mark in signs.marks):
        return True
    return any(_has_format(folder / name, value) for name, value in signs.documents.items())


def _has_format(path: Path, value: str) -> bool:
    """Return whether a JSON document has this ``format``; a broken document counts if only MIRROR uses its name."""
    is_unique_name = path.name not in ("manifest.json", "run.json", "result.json", "views.json")
    try:
        if not path.is_file() or path.stat().st_size > _MAX_BYTES:
            return False
        document = decode_json(path.read_bytes())
    except OSError:
        return False
    except JsonError:
        return is_unique_name
    return isinstance(document, dict) and document.get("format") == value


def _is_temporary(name: str) -> bool:
    return name.startswith(".") and name.endswith(TEMPORARY)
