"""Images of a traversal in tar archives of about 64 MiB, frame by frame, addressed by ``uri`` and ``byte_offset``.

A bucket asks its price for every request, and a frame is read as a whole: the images of a frame lie side by side, and
the frames in their order. An archive is an ordinary tar file without compression, whose bytes depend on nothing but the
images and their names.
"""

from __future__ import annotations

import os
import shutil
import tarfile
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import BinaryIO, Final, NamedTuple

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.schema.files import temporary_path, unwritable_error

SHARD_BYTES: Final = 64 << 20
"""Size beyond which a frame begins the next shard."""

SHARD_SUFFIX: Final = ".tar"
_BLOCK: Final = tarfile.BLOCKSIZE


class ShardPlace(NamedTuple):
    """The place of an image in a shard.

    Attributes:
        shard: name of the shard's file.
        offset: first byte of the image in the file.
    """

    shard: str
    offset: int


def is_shard(uri: str) -> bool:
    """Return whether a file holds images side by side."""
    return uri.endswith(SHARD_SUFFIX)


class ShardWriter:
    """Writes images into the shards of one folder, one after the other.

    Args:
        folder: it; made if missing.
        prefix: first part of the shards' names.
        limit_bytes: size beyond which a frame begins the next shard.
    """

    def __init__(self, folder: Path, prefix: str = "images", *, limit_bytes: int = SHARD_BYTES) -> None:
        self.folder = folder
        self._prefix = prefix
        self._limit = limit_bytes
        self._count = 0
        self._file: BinaryIO | None = None
        self._size = 0

    def write_frame(self, images: Sequence[tuple[str, bytes]]) -> list[ShardPlace]:
        """Write the images of one frame side by side.

        Args:
            images: names in the archive, and bytes.

        Raises:
            DatasetError: the folder cannot be written.
        """
        total = sum(_BLOCK + _padded(len(data)) for _, data in images)
        try:
            if self._file is not None and self._size + total > self._limit:
                self._end()
            if self._file is None:
                self.folder.mkdir(parents=True, exist_ok=True)
                self._file = (self.folder / self._name).open("xb")
                self._size = 0
            places = []
            for name, data in images:
                info = tarfile.TarInfo(name)
                info.size, info.mode = len(data), 0o644
                self._file.write(info.tobuf(tarfile.USTAR_FORMAT))
                places.append(ShardPlace(self._name, self._size + _BLOCK))
                self._file.write(data)
                self._file.write(bytes(_padded(len(data)) - len(data)))
                self._size += _BLOCK + _padded(len(data))
        except OSError as error:
            raise unwritable_error(self.folder / self._name, error) from error
        return places

    def close(self) -> None:
        """Complete the last shard.

        Raises:
            DatasetError: the folder cannot be written.
        """
        try:
            self._end()
        except OSError as error:
            raise unwritable_error(self.folder / self._name, error) from error

    @property
    def _name(self) -> str:
        return f"{self._prefix}-{self._count:05d}{SHARD_SUFFIX}"

    def _end(self) -> None:
        if self._file is None:
            return
        # Two empty blocks end an archive.
        self._file.write(bytes(2 * _BLOCK))
        self._file.close()
        self._file = None
        self._count += 1


def pack_images(images: pa.Table, root: Path, folder: str, *, limit_bytes: int = SHARD_BYTES) -> pa.Table:
    """Move the image files of a traversal into shards.

    Args:
        images: rows of the images table; images in videos or outside of the dataset stay where they are.
        root: the folder that uris are relative to.
        folder: where the shards get written, relative to it.
        limit_bytes: size beyond which a frame begins the next shard.

    Returns:
        The rows, with the images' places in the shards.

    Raises:
        DatasetError: a file cannot be read or written.
    """
    uris, offsets = images.column("uri").to_pylist(), images.column("byte_offset").to_pylist()
    codecs = images.column("codec").to_pylist()
    rows = [row for row, uri in enumerate(uris) if codecs[row] != "video" and "://" not in uri]
    writer = ShardWriter(root / folder, limit_bytes=limit_bytes)
    try:
        for frame in frames_in_order(images, rows):
            packed = [
                (PurePosixPath(uris[row]).relative_to(folder).as_posix(), _read(root / uris[row])) for row in frame
            ]
            for row, place in zip(frame, writer.write_frame(packed)):
                (root / uris[row]).unlink()
                uris[row], offsets[row] = f"{folder}/{place.shard}", place.offset
    finally:
        writer.close()
    for camera in {(root / folder / name) for name in images.column("camera").to_pylist()}:
        if camera.is_dir() and not any(camera.iterdir()):
            camera.rmdir()
    names = images.column_names
    images = images.set_column(names.index("uri"), images.schema.field("uri"), pa.array(uris, pa.string()))
    return images.set_column(
        names.index("byte_offset"), images.schema.field("byte_offset"), pa.array(offsets, pa.int64())
    )


def blank_images(path: Path, ranges: Sequence[tuple[int, int]]) -> bool:
    """Replace a file by one in which some images are zeros; the others keep their places and bytes.

    An archive stays one that other programs open, and tables that name its images stay true.

    Args:
        path: the file.
        ranges: first byte and length of each image.

    Returns:
        False: they were zeros before, and nothing was written.

    Raises:
        DatasetError: the file cannot be read or written.
    """
    temporary = temporary_path(path)
    try:
        with path.open("rb") as file:
            if not any(any(os.pread(file.fileno(), length, offset)) for offset, length in ranges):
                return False
        shutil.copyfile(path, temporary)
        with temporary.open("r+b") as file:
            for offset, length in ranges:
                os.pwrite(file.fileno(), bytes(length), offset)
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise unwritable_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)
    return True


def frames_in_order(images: pa.Table, rows: Sequence[int]) -> Iterator[list[int]]:
    """Yield rows of the images table frame by frame; an image of no frame comes after the frame before it."""
    stamps = np.asarray(images.column("timestamp_ns").to_numpy(), np.int64)
    indices = images.column("frame_index").to_pylist()
    cameras = images.column("camera").to_pylist()
    first: dict[int, int] = {}
    for row in rows:
        index = indices[row]
        if index is not None:
            first[index] = min(first.get(index, stamps[row]), stamps[row])
    known = sorted(first)
    starts: Int64 = np.array([first[index] for index in known], np.int64)

    def key(row: int) -> tuple[int, int, str, int]:
        index = indices[row]
        if index is not None:
            return index, 0, cameras[row], int(stamps[row])
        before = int(np.searchsorted(starts, stamps[row], side="right")) - 1
        return (known[before] if before >= 0 else -1), 1, cameras[row], int(stamps[row])

    for _, frame in groupby(sorted(rows, key=key), key=lambda row: key(row)[:2]):
        yield list(frame)


def _padded(size: int) -> int:
    return -(-size // _BLOCK) * _BLOCK


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise unwritable_error(path, error) from error
