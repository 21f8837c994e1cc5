"""What a folder is, by the documents in it, so that no verb writes into a folder that is something else.

Every verb that takes ``--out`` calls one of two functions before it writes anything:

- `require_output_folder(out, FolderKind.RESULTS)`: ``out`` is a folder, and becomes a folder of that kind. It may be absent,
  empty, or of that kind already (then the verb decides whether it goes on, adds to it or refuses). With no kind it must
  be absent or empty. The kind of what is there is returned; None: nothing.
- `require_output_file(out)`: ``out`` is one file, such as a page or a video.

Both refuse a path inside a dataset, a recording, a submission or hidden truth: their content is hashed or immutable. A
folder that an interrupted run left is of its kind too; what says so is listed with the kind (`_KINDS`). A verb whose
output is a new kind of folder adds a row there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final

from mirror.errors import UsageError
from mirror.schema.files import TEMPORARY
from mirror.schema.strict_json import JsonError, decode_json

_MOST_BYTES: Final = 64 * 1024 * 1024
_DATASET_NAMES: Final = frozenset(
    {"traversals", "drives", "rigs", "splits", "index", "rois.geojson", ".lock", ".staging", ".superseded"}
)


class FolderKind(Enum):
    """What a folder is, in words for messages."""

    DATASET = "a dataset"
    RECORDING = "a recording"
    RECORDINGS = "a folder of recordings"
    SUBMISSION = "a submission"
    HIDDEN = "hidden truth"
    MODEL = "a reconstructed model"
    RUN = "a training run"
    RESULTS = "results of `mirror evaluate`"
    DEMO = "the folder of a demo"
    BOARD = "a leaderboard's folder"
    SITE = "the site of a leaderboard"
    OTHER = "a folder with other files"


@dataclass(frozen=True)
class _Signs:
    """How a kind is recognised.

    Attributes:
        documents: names of JSON files, each with the value of its key ``format``.
        marks: files or folders whose presence alone says it: of a run that has begun and is not done.
        sealed: nothing else may be written inside.
    """

    documents: Mapping[str, str] = field(default_factory=dict)
    marks: tuple[str, ...] = ()
    sealed: bool = False


_KINDS: Final[Mapping[FolderKind, _Signs]] = {
    FolderKind.DATASET: _Signs({"dataset.json": "mirror"}, sealed=True),
    FolderKind.RECORDING: _Signs({"recording.json": "mirror-folder"}, sealed=True),
    FolderKind.RECORDINGS: _Signs({"synth.json": "mirror-synth"}),
    FolderKind.SUBMISSION: _Signs(
        {"manifest.json": "mirror-submission", "views.json": "mirror-views"}, marks=(".rendering",), sealed=True
    ),
    FolderKind.HIDDEN: _Signs({"hidden.json": "mirror-hidden-truth"}, sealed=True),
    FolderKind.MODEL: _Signs({"reconstruction.json": "mirror-reconstruction"}),
    FolderKind.RUN: _Signs({"run.json": "mirror-run"}),
    FolderKind.RESULTS: _Signs({"result.json": "mirror-result"}, marks=("work/scored.jsonl", "work/features")),
    FolderKind.DEMO: _Signs(marks=(".made-by-mirror-demo",)),
    FolderKind.BOARD: _Signs(marks=("entries",)),
    FolderKind.SITE: _Signs(marks=(".made-by-mirror-leaderboard",)),
}


def find_kind(folder: Path) -> FolderKind | None:
    """What a folder is; None: it does not exist or is empty (but for what a killed process left of one file).

    A document that is broken still says what the folder is if its name alone does: reading it then names what is wrong.

    Raises:
        UsageError: it is a file.
    """
    if not folder.is_dir():
        if folder.exists():
            raise UsageError(f"cannot be written: {folder} is a file", file=folder, expected="a folder")
        return None
    names = {one.name for one in folder.iterdir() if not _is_unfinished(one.name)}
    if not names:
        return None
    found = next((kind for kind, signs in _KINDS.items() if _has(folder, signs)), None)
    if found is not None:
        return found
    if names <= _DATASET_NAMES and names & {"traversals", ".lock", ".staging"}:
        # What an interrupted first ingest left: dataset.json is written with the first complete drive.
        return FolderKind.DATASET
    if any((one / "recording.json").is_file() for one in folder.iterdir()):
        return FolderKind.RECORDINGS
    return FolderKind.OTHER


def require_output_folder(out: Path, *kinds: FolderKind, place: str = "--out") -> FolderKind | None:
    """Refuse an output folder that is something else.

    Args:
        out: the folder that a verb is about to write.
        kinds: what it may be already; with none it must be absent or empty.
        place: the option that named it.

    Returns:
        What is there; None: nothing.

    Raises:
        UsageError: it is a file, holds something else, or lies inside a folder that nothing may be added to.
    """
    _refuse_inside(out, place)
    found = find_kind(out)
    if found is None or found in kinds:
        return found
    own = ", or ".join(["a new or an empty folder", *(kind.value for kind in kinds)])
    raise UsageError(
        f"it is {found.value}: nothing was written",
        file=out,
        place=place,
        expected=own,
        remedy=f"name another folder with {place}",
    )


def require_output_file(out: Path, *, place: str = "--out") -> None:
    """Refuse an output file that would lie inside something else, or in place of a folder.

    Raises:
        UsageError: it is a folder, or lies inside a folder that nothing may be added to.
    """
    _refuse_inside(out, place)
    if out.is_dir():
        raise UsageError("a folder, not a file", file=out, place=place, expected="the name of a file")


def _refuse_inside(out: Path, place: str) -> None:
    for folder in out.absolute().resolve().parents:
        for kind, signs in _KINDS.items():
            if signs.sealed and _has(folder, signs):
                raise UsageError(
                    f"it lies inside {folder}, which is {kind.value}: nothing was written",
                    file=out,
                    place=place,
                    expected=f"a place outside of {kind.value}",
                    remedy=f"name another place with {place}",
                )


def _has(folder: Path, signs: _Signs) -> bool:
    if any((folder / mark).exists() for mark in signs.marks):
        return True
    return any(_says(folder / name, value) for name, value in signs.documents.items())


def _says(path: Path, value: str) -> bool:
    """Whether a JSON document has this ``format``; a broken one with a name of ours alone counts as ours."""
    own_name = path.name not in ("manifest.json", "run.json", "result.json", "views.json")
    try:
        if not path.is_file() or path.stat().st_size > _MOST_BYTES:
            return False
        document = decode_json(path.read_bytes())
    except OSError:
        return False
    except JsonError:
        return own_name
    return isinstance(document, dict) and document.get("format") == value


def _is_unfinished(name: str) -> bool:
    return name.startswith(".") and name.endswith(TEMPORARY)
