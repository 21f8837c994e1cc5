"""A folder of clips: one compressed file for each, and a document that lists them and is written last."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.clips.map_lines import MapLine
from mirror.arrays import AnyArray
from mirror.errors import DatasetError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_bytes, write_json

_LIST: Final = "clips.json"
_SUFFIX: Final = ".npz"
_BOXES: Final = "boxes_"
_NEEDED: Final = (
    *(field.name for field in fields(Clip) if field.name not in ("boxes", "tracks", "lines")),
    *(f"{_BOXES}{field.name}" for field in fields(ClipBoxes)),
)
_LINES: Final = ("lines_kind", "lines_count", "lines_points_m")
_SCALARS: Final = ("clip_id", "drive_id", "rate_hz")


class ClipList(Document):
    """``clips.json``: the clips of a folder.

    Attributes:
        format: always ``mirror-clips``.
        version: version of this document.
        source: what the clips were made of.
        training: ids of the clips to train on.
        test: ids of the clips of other drives, to score on.
    """

    format: Literal["mirror-clips"] = "mirror-clips"
    version: Literal["1"] = "1"
    source: str
    training: tuple[str, ...]
    test: tuple[str, ...]


def clip_path(folder: Path, clip_id: str) -> Path:
    """Return the file of a clip."""
    return folder / f"{clip_id}{_SUFFIX}"


def write_clip(folder: Path, clip: Clip) -> None:
    """Write a clip under a temporary name, then rename it.

    Raises:
        DatasetError: the folder is not writable.
    """
    arrays: dict[str, Any] = {}
    for field in fields(Clip):
        value = getattr(clip, field.name)
        if field.name == "boxes":
            arrays |= {f"{_BOXES}{part.name}": getattr(value, part.name) for part in fields(ClipBoxes)}
        elif field.name == "lines":
            # Last, and only where a map is known: files without one have the bytes that they always had.
            arrays |= {} if value is None else _pack_lines(value)
        elif value is not None:
            arrays[field.name] = np.asarray(value)
    sink = io.BytesIO()
    np.savez_compressed(sink, **arrays)
    write_bytes(clip_path(folder, clip.clip_id), sink.getvalue())


def read_clip(folder: Path, clip_id: str) -> Clip:
    """Read a clip.

    Raises:
        DatasetError: the file is missing or broken, or its arrays do not fit each other.
    """
    path = clip_path(folder, clip_id)
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        missing = [name for name in _NEEDED if name not in arrays]
        if missing:
            raise ValueError(f"no {', '.join(missing)} in it")
        boxes = ClipBoxes(**{part.name: arrays.pop(f"{_BOXES}{part.name}") for part in fields(ClipBoxes)})
        for name in _SCALARS:
            arrays[name] = arrays[name].item()
        arrays["views"] = tuple(arrays["views"].tolist())
        lines = _unpack_lines({name: arrays.pop(name) for name in _LINES if name in arrays})
        return Clip(**arrays, boxes=boxes, lines=lines)
    except DatasetError as error:
        raise DatasetError(
            error.problem, file=path, place=error.place, expected=error.expected,
            remedy=error.remedy or "make the clips again: remove this file",
        ) from error  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise DatasetError(
            f"cannot be read ({error})", file=path, expected="a clip", remedy="make the clips again: remove this file"
        ) from error


def _pack_lines(lines: Sequence[MapLine]) -> dict[str, AnyArray]:
    """The lines of a map as arrays: kinds (L,), numbers of points (L,), and all points (P, 3)."""
    points = [np.zeros((0, 3)), *(line.points_m for line in lines)]
    kinds = np.array([line.kind for line in lines], np.str_)
    return dict(zip(_LINES, (kinds, np.array([len(one) for one in points[1:]], np.int64), np.concatenate(points))))


def _unpack_lines(arrays: Mapping[str, AnyArray]) -> tuple[MapLine, ...] | None:
    if not arrays:
        return None
    kinds, counts, points = (arrays[name] for name in _LINES)
    if kinds.shape != counts.shape or counts.sum() != len(points):
        raise ValueError(f"{len(points)} points for lines of {counts.sum()}")
    parts = np.split(points, np.cumsum(counts)[:-1]) if len(counts) else []
    return tuple(MapLine(kind, part) for kind, part in zip(kinds.tolist(), parts))


def write_list(folder: Path, clips: ClipList) -> None:
    """Write the document, after all clips."""
    write_json(folder / _LIST, clips)


def read_list(folder: Path) -> ClipList:
    """Read the document of a folder.

    Raises:
        DatasetError: the folder holds no clips, or they are not complete yet.
        SchemaError: the document is broken.
    """
    if not (folder / _LIST).is_file():
        raise DatasetError(
            "no clips.json" if folder.is_dir() else "no such folder", file=folder, expected="a folder of clips",
            remedy="make it: `python -m benchmarks generation clips --out STUDY` writes STUDY/clips, clips.json last",
        )  # fmt: skip
    return read_json(folder / _LIST, ClipList)


def read_clips(folder: Path, clip_ids: Sequence[str]) -> list[Clip]:
    """Read several clips; errors are those of `read_clip`."""
    return [read_clip(folder, clip_id) for clip_id in clip_ids]
