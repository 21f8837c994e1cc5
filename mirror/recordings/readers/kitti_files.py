"""Files that the data sets of KITTI share: rows of numbers, named values, stamps of frames and numbered images."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.recordings.opening import read_file
from mirror.recordings.paths import list_folder
from mirror.recordings.protocol import FileStream
from mirror.recordings.raster import codec_of_name
from mirror.recordings.readers.stored_poses import REMEDY
from mirror.recordings.stamps import require_zone

NO_STAMP: Final = np.iinfo(np.int64).min
"""In a list of stamps by frame: the frame has none."""

CAMERA_HEIGHT_M: Final = 1.65
RECEIVER_HEIGHT_M: Final = 0.93
"""Heights above the road of the first camera and of the receiver of KITTI's station wagon, by the figure of its sensor
setup, which the data set's page and its paper have (A. Geiger et al., "Vision meets robotics: the KITTI dataset", IJRR
2013)."""

_STAMP: Final = re.compile(r"\d{4}-\d{2}-\d{2} \d{2}:\d{2}:\d{2}(?:\.\d{1,9})?")
# Beyond it a number of a calibration is none, and its products leave float64.
_LARGEST: Final = 1e30
_AGAIN: Final = "download the calibration again"


@dataclass(frozen=True)
class NumberRows:
    """The rows of a text file that hold numbers.

    Attributes:
        file: the file.
        line: (N,) numbers of their lines, from 1.
        values: (N, K) the numbers.
        torn: the lines that are no rows: the number of rows before each, and its error.
    """

    file: Path
    line: Int64
    values: Float64
    torn: list[tuple[int, RecordingError]]


def read_number_rows(file: Path, count: int, expected: str) -> NumberRows:
    """Read rows of numbers that blanks separate.

    Args:
        file: the file.
        count: numbers in a row.
        expected: what a row is, for the errors of other lines.

    Raises:
        RecordingError: the file is missing or unreadable.
    """
    rows, places, torn = [], [], []
    for number, line in enumerate(read_file(file).decode(errors="replace").splitlines(), 1):
        words = line.split()
        try:
            if len(words) != count:
                raise ValueError(f"{len(words)} numbers")
            rows.append([float(word) for word in words])
            places.append(number)
        except ValueError as problem:
            place = f"line {number}"
            fault = RecordingError(f"{problem!s:.80}", file=file, place=place, expected=expected, remedy=REMEDY)
            torn.append((len(rows), fault))
    return NumberRows(file, np.array(places, np.int64), np.array(rows, np.float64).reshape(-1, count), torn)


def read_named_values(file: Path) -> dict[str, list[str]]:
    """Read the words of each line ``name: values``."""
    lines = read_file(file).decode(errors="replace").splitlines()
    return {name.strip(): values.split() for name, found, values in (line.partition(":") for line in lines) if found}


def to_numbers(lines: Mapping[str, list[str]], name: str, shape: tuple[int, ...], file: Path) -> Float64:
    """Convert a line that `read_named_values` has read to numbers.

    Raises:
        RecordingError: the line is missing, or has other values; it is named.
    """
    try:
        values = np.array([float(word) for word in lines[name]], np.float64).reshape(shape)
        if not (np.abs(values) < _LARGEST).all():
            raise ValueError("not finite, or too large")
        return values
    except (KeyError, ValueError) as error:
        raise RecordingError(
            "the line is missing" if isinstance(error, KeyError) else f"values that cannot be used ({error!s:.80})",
            file=file,
            place=name,
            expected=f"numbers of shape {shape}",
            remedy=_AGAIN,
        ) from error


def read_frame_stamps(file: Path, tz: str) -> Int64:
    """Read the stamp of each frame: a line of date and time without a zone.

    Args:
        file: ``timestamps.txt``.
        tz: the zone of the stamps.

    Returns:
        (N,) Unix time, UTC; `NO_STAMP` where a line is no stamp.

    Raises:
        RecordingError: the file is unreadable, or the zone is unknown.
    """
    import pyarrow.compute as pc

    lines = read_file(file).decode(errors="replace").splitlines()
    none = np.datetime64("NaT", "ns")
    values = np.array(
        [np.datetime64(line.strip().replace(" ", "T"), "ns") if _is_stamp(line) else none for line in lines],
        "datetime64[ns]",
    )
    known = ~np.isnat(values)
    require_zone(tz)
    local = pa.array(values[known], pa.timestamp("ns"))
    utc = pc.assume_timezone(local, tz, ambiguous="earliest", nonexistent="earliest").cast(pa.int64())
    stamps = np.full(len(lines), NO_STAMP)
    stamps[known] = np.asarray(utc)
    return stamps


def _is_stamp(line: str) -> bool:
    if not _STAMP.fullmatch(line.strip()):
        return False
    try:
        np.datetime64(line.strip().replace(" ", "T"), "ns")
    except ValueError:
        return False
    return True


def list_numbered_files(
    root: Path, folder: Path, digits: int, suffixes: Sequence[str], what: str = "image of the camera"
) -> dict[int, Path]:
    """List the files of a sensor by frame number, ascending; empty if there is no such folder.

    Args:
        root: the folder of the data set.
        folder: the folder of the files.
        digits: number of digits of a name.
        suffixes: suffixes of the names; all files have the same.
        what: a file in words, for the message.

    Raises:
        RecordingError: a file has another name.
    """
    if not folder.is_dir():
        return {}
    files, first = {}, None
    for name, file in list_folder(root, folder).items():
        stem, _, suffix = name.rpartition(".")
        first = first or suffix
        if suffix not in suffixes or suffix != first or not stem.isdecimal() or len(stem) != digits:
            raise RecordingError(
                f"no {what}",
                file=file,
                expected=f"{digits} digits and .{first if first in suffixes else ' or .'.join(suffixes)}",
                remedy="move it elsewhere",
            )
        files[int(stem)] = file
    return dict(sorted(files.items()))


def stamps_of_frames(files: Mapping[int, Path], by_frame: Int64, place: Path, remedy: str) -> Int64:
    """Return the stamp of each file of a sensor.

    Args:
        files: files by frame, ascending.
        by_frame: stamps of the frames by their number.
        place: the file of the stamps, for the message.
        remedy: where to get it.

    Returns:
        (N,) Unix time.

    Raises:
        RecordingError: the frame of a file has no stamp; the file is named.
    """
    frames = np.fromiter(files, np.int64, len(files))
    inside = frames < len(by_frame)
    stamps: Int64 = np.where(inside, by_frame[np.where(inside, frames, 0)] if len(by_frame) else 0, 0)
    missing = ~inside | (stamps == NO_STAMP)
    if missing.any():
        raise RecordingError(
            "the frame has no stamp",
            file=files[int(frames[np.argmax(missing)])],
            expected=f"a line with its number in {place.name}",
            remedy=remedy,
        )
    return stamps


def to_frame_stream(camera: str, files: Mapping[int, Path], by_frame: Int64, place: Path, remedy: str) -> FileStream:
    """Return the images of a camera; a stamp is taken as mid-exposure, exposure lengths are not recorded.

    Args:
        camera: the camera's name.
        files: images by frame, ascending, one at least.
        by_frame: stamps of the frames by their number.
        place: the file of the stamps, for the message.
        remedy: where to get it.

    Raises:
        RecordingError: the frame of an image has no stamp; the image is named.
    """
    stamps = stamps_of_frames(files, by_frame, place, remedy)
    paths = tuple(files.values())
    return FileStream(camera, codec_of_name(paths[0]), stamps, stamps, paths)


def camera_centre(projection: Float64, name: str, file: Path) -> Float64:
    """Return the place of a rectified camera in the frame in which its projection is ``K [I | t]``.

    Args:
        projection: (3, 4).
        name: the name of its line, for the message.
        file: the file, for the message.

    Returns:
        (3,) metres.

    Raises:
        RecordingError: a focal length is not positive.
    """
    focal = projection[[0, 1], [0, 1]]
    if not (focal > 0.0).all():
        raise RecordingError(
            f"focal lengths {focal.tolist()}", file=file, place=name, expected="positive numbers", remedy=_AGAIN
        )
    along = projection[2, 3]
    with np.errstate(over="ignore", invalid="ignore"):
        across = (projection[:2, 3] - projection[:2, 2] * along) / focal
    return -np.array([*across, along])
