"""The files of images: sizes, end markers and contents. Each file is opened once for all rules."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from threading import Lock
from typing import Final, TypeVar

import numpy as np

from mirror.arrays import Bool, Int64, UInt8
from mirror.dataset.images.decoding import decode_rgb
from mirror.dataset.images.video_decoders import VideoDecoders
from mirror.dataset.store import Store
from mirror.dataset.uris import uri_etag
from mirror.errors import MirrorError
from mirror.integrity.rows import TableRows
from mirror.pools import thread_pool, usable_cores
from mirror.recordings.raster import TAIL_BYTES, has_end_marker

MISSING: Final = -1
LEAVES_DATASET: Final = -2
_CHUNK = 256
_RANGE = 255
_INTACT = (True, True, 0, 0, _RANGE)
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class ImageFiles:
    """Sizes and end markers of the files of N images.

    Attributes:
        size: (N,) size of the file in bytes; `MISSING`; or `LEAVES_DATASET`: its uri leads out of the dataset.
        ended: (N,) True if a JPEG or PNG has its end marker; True for videos and unreadable files.
        etag: N tags that stores give to the bytes of images outside of the dataset; None: there is none.
    """

    size: Int64
    ended: Bool
    etag: Sequence[str | None] = ()


@dataclass(frozen=True)
class ImageContents:
    """Contents of the files of N images. Missing and short files count as correct: other rules report them.

    Attributes:
        same_bytes: (N,) False if the SHA-256 of the bytes differs from the one in the table.
        decodes: (N,) False if the image cannot be decoded.
        width_px: (N,) width of the decoded image; 0 where it was not decoded.
        height_px: (N,) height of the decoded image.
        spread: (N,) difference between its largest and smallest value; 255 where it was not decoded.
    """

    same_bytes: Bool
    decodes: Bool
    width_px: Int64
    height_px: Int64
    spread: Int64


class ImageFileReader:
    """A reader of the files of images, with several threads.

    Args:
        images: the images.
        store: the dataset's files.
        sizes: sizes of its files, by path; None: they are asked for.
    """

    def __init__(self, images: TableRows, store: Store, sizes: Mapping[str, int] | None = None) -> None:
        self._store = store
        self._sizes = sizes
        self._uri: list[str] = images.data.column("uri").to_pylist()
        self._offset = images.integers("byte_offset")
        self._length = images.integers("byte_length")
        codes, words = images.text_codes("codec")
        self._codec = [words[code] for code in codes.tolist()]
        self._sha256: list[bytes | None] = images.data.column("sha256").to_pylist()
        self._pts: list[int | None] = images.data.column("video_pts").to_pylist()
        self._videos = VideoDecoders(store)
        self._video_sha256: dict[str, bytes] = {}
        self._lock = Lock()

    def files(self) -> ImageFiles:
        """Read the sizes and end markers of the files."""
        found = self._each(self._file)
        return ImageFiles(
            np.array([size for size, _, _ in found], np.int64),
            np.array([ended for _, ended, _ in found], np.bool_),
            [etag for _, _, etag in found],
        )

    def contents(self, files: ImageFiles) -> ImageContents:
        """Decode the images and compute their hashes, sizes and value ranges.

        Args:
            files: result of `files`; a file that is too short is not read.
        """
        size = files.size.tolist()
        read = [self._whole(row, size[row]) for row in range(len(size))]
        rows = self._each(lambda row: self._content(row) if read[row] else _INTACT)
        found = np.array(rows, np.int64).reshape(-1, 5)
        return ImageContents(found[:, 0] > 0, found[:, 1] > 0, found[:, 2], found[:, 3], found[:, 4])

    def _each(self, read: Callable[[int], Answer]) -> list[Answer]:
        # A task for each image would cost more than reading its file.
        chunks = [range(start, min(start + _CHUNK, len(self._uri))) for start in range(0, len(self._uri), _CHUNK)]
        with thread_pool(usable_cores()) as pool:
            return [answer for part in pool.map(lambda rows: [read(row) for row in rows], chunks) for answer in part]

    def _file(self, row: int) -> tuple[int, bool, str | None]:
        uri, end_of_bytes = self._uri[row], int(self._offset[row] + self._length[row])
        if leaves_dataset(uri):
            return LEAVES_DATASET, True, None
        try:
            size, etag = stored_size(self._store, uri, self._sizes)
            if self._codec[row] == "video" or not self._whole(row, size):
                return size, True, etag
            tail = min(int(self._length[row]), TAIL_BYTES)
            ended = has_end_marker(self._store.read_range(uri, end_of_bytes - tail, tail), self._codec[row])
            return size, ended, etag
        except (OSError, MirrorError):
            return MISSING, True, None

    def _content(self, row: int) -> tuple[bool, bool, int, int, int]:
        uri, length = self._uri[row], int(self._length[row])
        try:
            if self._codec[row] == "video":
                same = self._same_video(uri, self._sha256[row])
                pts = self._pts[row]
                pixels = None if pts is None else self._videos.decode(uri, pts)
            else:
                data = self._store.read_range(uri, int(self._offset[row]), length)
                expected = self._sha256[row]
                same = expected is None or hashlib.sha256(data).digest() == expected
                pixels = decode_rgb(data, self._codec[row])
        except (OSError, MirrorError):
            return _INTACT
        if pixels is None:
            return same, False, 0, 0, _RANGE
        return same, True, pixels.shape[1], pixels.shape[0], _spread(pixels)

    def _whole(self, row: int, size: int) -> bool:
        """Return whether a file of that size holds all bytes of an image."""
        offset, length = int(self._offset[row]), int(self._length[row])
        return offset >= 0 and length > 0 and size >= offset + length

    def _same_video(self, uri: str, expected: bytes | None) -> bool:
        if expected is None:
            return True
        with self._lock:
            if uri not in self._video_sha256:
                self._video_sha256[uri] = hashlib.sha256(self._store.read(uri)).digest()
            return self._video_sha256[uri] == expected


def stored_size(store: Store, uri: str, sizes: Mapping[str, int] | None = None) -> tuple[int, str | None]:
    """Return the size of the file of a uri in bytes, and the tag that a store gives to its bytes; None: it gives none.

    Args:
        store: the dataset's files.
        uri: relative to the dataset, or absolute.
        sizes: sizes of the dataset's files, by path; None: they are asked for.

    Raises:
        OSError: it is missing, or cannot be asked for.
        DatasetError: no installed package reads the uri.
    """
    if sizes is not None and "://" not in uri and not uri.startswith("/"):
        if uri not in sizes:
            raise FileNotFoundError(uri)
        return sizes[uri], None
    place = store.resolve(uri)
    if isinstance(place, Path):
        return place.stat().st_size, None
    entry = place[0].info(place[1])
    return int(entry["size"]), uri_etag(entry)


def leaves_dataset(uri: str) -> bool:
    """Return whether an image's relative uri leads out of the dataset."""
    return ".." in uri and ".." in PurePosixPath(uri).parts


def _spread(pixels: UInt8) -> int:
    """Difference between the largest and smallest value in every fourth row and column."""
    some = pixels[::4, ::4]
    return int(some.max()) - int(some.min())
