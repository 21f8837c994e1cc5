"""Cameras, images and frames of a COLMAP model, binary or text; points are not read.

Counts in a damaged file never decide how much memory is taken: every read is checked against the bytes that are left.

Source: https://colmap.github.io/format.html
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.recordings.coordinates import is_invalid_rotation
from mirror.recordings.opening import find_file, read_file

# Number of parameters by model, in the order of COLMAP's model ids; None: an id that is not used.
_MODELS: Final = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
)
_COUNTS: Final = dict(_MODELS)
_SENSOR_CAMERA: Final = 0
_POINT_BYTES: Final = 24
_REMEDY: Final = "export the model again with `colmap model_converter`"


@dataclass(frozen=True)
class ColmapCamera:
    """One camera of a COLMAP model.

    Attributes:
        model: COLMAP's name of the model.
        width_px: width of the raster.
        height_px: height of the raster.
        parameters: in the order of the model.
    """

    model: str
    width_px: int
    height_px: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class ColmapImages:
    """The N registered images in the order of their ids.

    Attributes:
        image_id: ids.
        camera_id: id of each image's camera.
        name: paths relative to the folder of images, with forward slashes.
        camera_SE3_world: (N,) poses.
    """

    image_id: tuple[int, ...]
    camera_id: tuple[int, ...]
    name: tuple[str, ...]
    camera_SE3_world: Poses


@dataclass(frozen=True)
class ColmapModel:
    """A COLMAP model: its cameras and its registered images.

    Attributes:
        files: the files that were read, by name.
        cameras: by id.
        images: the registered images.
        frame_of: id of the frame by id of image; empty for a model without frames.
    """

    files: dict[str, Path]
    cameras: dict[int, ColmapCamera]
    images: ColmapImages
    frame_of: dict[int, int]


def read_model(root: Path, folder: str) -> ColmapModel:
    """Read a model; binary files come before text files.

    Args:
        root: the recording's folder.
        folder: the model's folder, relative to it.

    Raises:
        RecordingError: a file is missing or damaged; its place is named.
    """
    prefix = f"{folder}/" if folder else ""
    files: dict[str, Path] = {}
    for suffix in (".bin", ".txt"):
        found = {name: find_file(root, f"{prefix}{name}{suffix}") for name in ("cameras", "images", "frames")}
        if found["cameras"] is not None or found["images"] is not None:
            files = {name: file for name, file in found.items() if file is not None}
            break
    for name in ("cameras", "images"):
        if name not in files:
            raise RecordingError(
                "missing", file=root / f"{prefix}{name}.bin", expected="a model of COLMAP", remedy=_REMEDY
            )
    binary = files["cameras"].suffix == ".bin"
    if binary:
        cameras = _cameras_binary(_Bytes(files["cameras"]))
        images = _images_binary(_Bytes(files["images"]))
        frame_of = _frames_binary(_Bytes(files["frames"])) if "frames" in files else {}
    else:
        cameras = _cameras_text(files["cameras"])
        images = _images_text(files["images"])
        frame_of = _frames_text(files["frames"]) if "frames" in files else {}
    rows = sorted(images, key=lambda row: row[0])
    return ColmapModel(files, cameras, _to_images(rows, cameras, files["images"]), frame_of)


def count_images(root: Path, folder: str) -> int:
    """Return the number of registered images of a model.

    Args:
        root: the recording's folder.
        folder: the model's folder, relative to it.

    Raises:
        RecordingError: the file of images is damaged.
    """
    binary = find_file(root, f"{folder}/images.bin")
    if binary is not None:
        return int(_Bytes(binary).unpack("Q")[0])
    text = find_file(root, f"{folder}/images.txt")
    return 0 if text is None else len(_images_text(text))


_Row = tuple[int, tuple[float, ...], int, str]
"""Id, quaternion and translation, id of the camera, name."""


def _to_images(rows: list[_Row], cameras: dict[int, ColmapCamera], file: Path) -> ColmapImages:
    if not rows:
        raise RecordingError("no registered image", file=file, expected="at least one", remedy="run `colmap mapper`")
    pose = np.array([row[1] for row in rows], np.float64)
    bad = is_invalid_rotation(pose[:, :4]) | ~(np.abs(pose[:, 4:]) < 1e12).all(axis=1)
    bad |= np.array([row[2] not in cameras or not row[3] for row in rows])
    if bad.any():
        row = rows[int(np.argmax(bad))]
        raise RecordingError(
            f"image {row[0]} {row[3]!r:.80} has the pose {list(row[1])} and the camera {row[2]}",
            file=file,
            place=f"image {row[0]}",
            expected="a name, a unit quaternion, a finite translation and a camera of the model",
            remedy=_REMEDY,
        )
    names = [row[3] for row in rows]
    if len(set(names)) < len(names):
        name = next(name for name in names if names.count(name) > 1)
        raise RecordingError(f"two images are named {name!r:.80}", file=file, expected="unique names", remedy=_REMEDY)
    ids, cameras_of = tuple(row[0] for row in rows), tuple(row[2] for row in rows)
    return ColmapImages(ids, cameras_of, tuple(names), Poses(pose[:, :4], pose[:, 4:]))


class _Bytes:
    """The bytes of a file, read from the start to the end."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._data = read_file(file)
        self._at = 0

    def unpack(self, layout: str) -> tuple[Any, ...]:
        """The next values, little-endian."""
        size = struct.calcsize("<" + layout)
        if self._at + size > len(self._data):
            self.refuse("the file ends in the middle of a record")
        values = struct.unpack_from("<" + layout, self._data, self._at)
        self._at += size
        return values

    def skip(self, size: int) -> None:
        """Skip bytes."""
        if self._at + size > len(self._data):
            self.refuse("the file ends in the middle of a record")
        self._at += size

    def text(self) -> str:
        """The text up to the next zero byte."""
        end = self._data.find(b"\0", self._at)
        if end < 0:
            self.refuse("a name without an end")
        raw = self._data[self._at : end]
        self._at = end + 1
        try:
            return raw.decode()
        except UnicodeDecodeError:
            self.refuse("a name that is not UTF-8")

    def counted(self) -> Iterator[int]:
        """Numbers of the records that the next count announces."""
        (count,) = self.unpack("Q")
        yield from range(count)
        if self._at != len(self._data):
            self.refuse("bytes after the last record")

    def refuse(self, problem: str) -> NoReturn:
        """Raise the error of this place.

        Raises:
            RecordingError: always.
        """
        raise RecordingError(
            problem, file=self.file, place=f"byte {self._at}", expected="a binary file of COLMAP", remedy=_REMEDY
        )


def _cameras_binary(data: _Bytes) -> dict[int, ColmapCamera]:
    cameras = {}
    for _ in data.counted():
        identity, model, width, height = data.unpack("IiQQ")
        if not 0 <= model < len(_MODELS):
            data.refuse(f"unknown camera model {model}")
        name, count = _MODELS[model]
        cameras[identity] = ColmapCamera(name, width, height, data.unpack(f"{count}d"))
    return cameras


def _images_binary(data: _Bytes) -> list[_Row]:
    rows: list[_Row] = []
    for _ in data.counted():
        identity, *pose, camera = data.unpack("I7dI")
        name = data.text()
        (points,) = data.unpack("Q")
        data.skip(points * _POINT_BYTES)
        rows.append((identity, tuple(pose), camera, name))
    return rows


def _frames_binary(data: _Bytes) -> dict[int, int]:
    frame_of: dict[int, int] = {}
    for _ in data.counted():
        identity, _, *_, count = data.unpack("II7dI")
        for _ in range(count):
            kind, _, image = data.unpack("iIQ")
            if kind == _SENSOR_CAMERA:
                frame_of[image] = identity
    return frame_of


def _lines(file: Path) -> list[tuple[int, str]]:
    """Numbers and texts of the lines that are no comments."""
    try:
        text = read_file(file).decode()
    except UnicodeDecodeError as error:
        raise RecordingError("not UTF-8 text", file=file, expected="a text file of COLMAP", remedy=_REMEDY) from error
    return [(number, line) for number, line in enumerate(text.split("\n"), 1) if not line.startswith("#")]


def _line_error(file: Path, number: int, problem: str) -> RecordingError:
    return RecordingError(problem, file=file, place=f"line {number}", expected="a text file of COLMAP", remedy=_REMEDY)


def _cameras_text(file: Path) -> dict[int, ColmapCamera]:
    cameras = {}
    for number, line in _lines(file):
        if not line.strip():
            continue
        try:
            identity, model, width, height, *parameters = line.split()
            camera = ColmapCamera(model, int(width), int(height), tuple(map(float, parameters)))
            cameras[int(identity)] = camera
        except ValueError as error:
            raise _line_error(file, number, f"not a camera ({error})") from error
        if model in _COUNTS and len(parameters) != _COUNTS[model]:
            raise _line_error(file, number, f"{len(parameters)} parameters of a {model}")
    return cameras


def _images_text(file: Path) -> list[_Row]:
    """Images of two lines each, the pose and the points; some programs leave the empty lines of points out."""
    rows: list[_Row] = []
    expects_points = False
    for number, line in _lines(file):
        if expects_points and _is_points(line):
            expects_points = False
            continue
        if not line.strip():
            continue
        try:
            identity, *pose, camera, name = line.split(maxsplit=9)
            if len(pose) != 7:
                raise ValueError(f"{len(pose)} numbers of a pose")
            rows.append((int(identity), tuple(map(float, pose)), int(camera), name.strip()))
        except ValueError as error:
            what = "neither points nor an image" if expects_points else "not an image"
            raise _line_error(file, number, f"{what} ({error})") from error
        expects_points = True
    return rows


def _is_points(line: str) -> bool:
    """Return whether a line lists points: triples of x, y and the point's id, or nothing."""
    words = line.split()
    try:
        return len(words) % 3 == 0 and all(map(math.isfinite, map(float, words)))
    except ValueError:
        return False


def _frames_text(file: Path) -> dict[int, int]:
    frame_of: dict[int, int] = {}
    for number, line in _lines(file):
        if not line.strip():
            continue
        words = line.split()
        try:
            count, data = int(words[9]), words[10:]
            if len(data) != 3 * count:
                raise ValueError(f"{len(data)} words for {count} images")
            for kind, image in zip(data[::3], data[2::3]):
                if kind == "CAMERA":
                    frame_of[int(image)] = int(words[0])
        except (ValueError, IndexError) as error:
            raise _line_error(file, number, f"not a frame ({error})") from error
    return frame_of
