"""A folder of clips: one compressed file for each, and a document that lists them and is written last."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from mirror.errors import DatasetError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_bytes, write_json

_LIST: Final = "clips.json"
_SUFFIX: Final = ".npz"
_BOXES: Final = "boxes_"
_NEEDED: Final = (
    *(field.name for field in fields(Clip) if field.name not in ("boxes", "tracks")),
    *(f"{_BOXES}{field.name}" for field in fields(ClipBoxes)),
)
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
    """The file of a clip."""
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
        return Clip(**arrays, boxes=boxes)
    except DatasetError as error:
        raise DatasetError(
            error.problem, file=path, place=error.place, expected=error.expected,
            remedy=error.remedy or "make the clips again: remove this file",
        ) from error  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise DatasetError(
            f"cannot be read ({error})", file=path, expected="a clip", remedy="make the clips again: remove this file"
        ) from error


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
            "no clips.json", file=folder, expected="a folder of clips",
            remedy="finish the command that makes the clips: it writes this file last",
        )  # fmt: skip
    return read_json(folder / _LIST, ClipList)


def read_clips(folder: Path, clip_ids: Sequence[str]) -> list[Clip]:
    """Read several clips; errors are those of `read_clip`."""
    return [read_clip(folder, clip_id) for clip_id in clip_ids]
