"""A folder of clips: one compressed file for each, and a document that lists them and is written last."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import IO, Any, Final, Literal, overload

import numpy as np

from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.clips.map_lines import MapLine
from hybridworldsim.kept_items import KeptItems
from mirror.arrays import AnyArray
from mirror.errors import DatasetError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_bytes, write_json

LIST: Final = "clips.json"
"""Name of the document that lists the clips of a folder; it is written last."""
KEEP_BYTES: Final = 2 << 30
"""Bytes of clips that a training keeps: as many as those of the study fit, larger sets are read again."""
_SUFFIX: Final = ".npz"
_BOXES: Final = "boxes_"
_NEEDED: Final = (
    *(field.name for field in fields(Clip) if field.name != "boxes" and field.default is MISSING),
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


@dataclass(frozen=True)
class ClipHeader:
    """The facts about a clip that are known without its images.

    Attributes:
        clip_id: id of the clip.
        drive_id: id of its drive.
        rate_hz: frames per second.
        views: (V) names of the cameras.
        frames: F, number of frames.
        size_px: height and width of the images.
        has_map: whether it has the lines of a map.
        is_weighted: whether its pixels differ in their weight; see `pixel_weights`.
    """

    clip_id: str
    drive_id: str
    rate_hz: float
    views: tuple[str, ...]
    frames: int
    size_px: tuple[int, int]
    has_map: bool
    is_weighted: bool


def header_of(clip: Clip) -> ClipHeader:
    """Return the header of a clip in memory."""
    return ClipHeader(
        clip.clip_id, clip.drive_id, clip.rate_hz, clip.views, len(clip), clip.size_px, clip.lines is not None,
        clip.excluded is not None or clip.hidden is not None,
    )  # fmt: skip


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
            # Optional parts come last, and only where they are known: files without them keep their bytes.
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
        raise _unreadable(path, error) from error


def read_header(folder: Path, clip_id: str) -> ClipHeader:
    """Read the header of a clip; its images are not read.

    Raises:
        DatasetError: the file is missing or broken.
    """
    path = clip_path(folder, clip_id)
    try:
        with zipfile.ZipFile(path) as archive, np.load(path, allow_pickle=False) as file:
            missing = [name for name in _NEEDED if name not in file.files]
            if missing:
                raise ValueError(f"no {', '.join(missing)} in it")
            with archive.open("images.npy") as member:
                shape = _array_shape(member)
            drive_id, rate_hz = file["drive_id"].item(), file["rate_hz"].item()
            return ClipHeader(
                clip_id, drive_id, rate_hz, tuple(file["views"].tolist()), shape[0], (shape[2], shape[3]),
                all(name in file.files for name in _LINES), not {"excluded", "hidden"}.isdisjoint(file.files),
            )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError, IndexError, EOFError, zipfile.BadZipFile) as error:
        raise _unreadable(path, error) from error


def _array_shape(member: IO[bytes]) -> tuple[int, ...]:
    """The shape in the header of an array's file."""
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    return read(member)[0]


def _unreadable(path: Path, error: Exception) -> DatasetError:
    return DatasetError(
        f"cannot be read ({error})", file=path, expected="a clip", remedy="make the clips again: remove this file"
    )


class ClipFiles(Sequence[Clip]):
    """The clips of a folder, read when they are needed; the most recently used ones are kept in memory.

    Args:
        folder: the folder.
        clip_ids: ids of the clips.
        keep_bytes: bytes of images and backgrounds that are kept.

    Attributes:
        headers: headers of all clips.

    Raises:
        DatasetError: a file is missing or broken.
    """

    def __init__(self, folder: Path, clip_ids: Sequence[str], keep_bytes: int = KEEP_BYTES) -> None:
        self._folder, self._clip_ids = folder, clip_ids
        self.headers = [read_header(folder, clip_id) for clip_id in clip_ids]
        self._kept: KeptItems[int, Clip] = KeptItems(keep_bytes)

    def __len__(self) -> int:
        return len(self._clip_ids)

    @overload
    def __getitem__(self, row: int) -> Clip: ...
    @overload
    def __getitem__(self, row: slice) -> list[Clip]: ...
    def __getitem__(self, row: int | slice) -> Clip | list[Clip]:
        """Read a clip, or those of a slice; errors are those of `read_clip`."""
        if isinstance(row, slice):
            return [self[one] for one in range(*row.indices(len(self)))]
        if not 0 <= row < len(self):
            raise IndexError(row)
        return self._kept.get(row, lambda: read_clip(self._folder, self._clip_ids[row]), _clip_bytes)


def _clip_bytes(clip: Clip) -> int:
    optional = (clip.tracks, clip.excluded, clip.hidden)
    return clip.images.nbytes + clip.background.nbytes + sum(one.nbytes for one in optional if one is not None)


def headers_of(clips: Sequence[Clip]) -> list[ClipHeader]:
    """Return the headers of clips, without reading the clips that are read lazily."""
    return clips.headers if isinstance(clips, ClipFiles) else [header_of(clip) for clip in clips]


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
    """Write ``clips.json`` into a folder; call it after all clips are written."""
    write_json(folder / LIST, clips)


def read_list(folder: Path) -> ClipList:
    """Read the ``clips.json`` of a folder.

    Raises:
        DatasetError: the folder holds no clips, or they are not complete yet.
        SchemaError: the document is broken.
    """
    if not (folder / LIST).is_file():
        raise DatasetError(
            "no clips.json" if folder.is_dir() else "no such folder", file=folder, expected="a folder of clips",
            remedy="make it: `mirror generate clips DATASET --background MODEL --out CLIPS` writes clips.json last",
        )  # fmt: skip
    return read_json(folder / LIST, ClipList)


def read_clips(folder: Path, clip_ids: Sequence[str]) -> list[Clip]:
    """Read several clips; see `read_clip` for the errors."""
    return [read_clip(folder, clip_id) for clip_id in clip_ids]
