"""Pictures of a traversal: linked or copied byte for byte, never re-encoded, hashed on the way; or referred to."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.protocol import ImageStream, ReferencedStream
from mirror.recordings.raster import raster_size, require_whole
from mirror.schema.files import unwritable

Transfer = Literal["link", "copy"]
_SUFFIX = {"jpeg": "jpg", "png": "png"}
_TOLD_EVERY = 16
_NOT_LINKABLE = (errno.EXDEV, errno.EPERM, errno.EMLINK, errno.ENOTSUP)


@dataclass(frozen=True)
class Placed:
    """The N pictures of one camera of a traversal.

    Attributes:
        names: file names in the camera's folder, or absolute uris.
        sizes: bytes of each.
        sha256: digest of each, or None where hashing is off or the pictures lie elsewhere.
        codec: ``jpeg`` or ``png``.
        width_px: (N,) of each; of files, of the first.
        height_px: (N,) of each; of files, of the first.
        linked: how many are hard links to the recording's own files.
    """

    names: list[str]
    sizes: list[int]
    sha256: list[bytes | None]
    codec: str
    width_px: Int64
    height_px: Int64
    linked: int


def refer_to_pictures(stream: ReferencedStream, selected: Int64, advance: Callable[[int], None]) -> Placed:
    """Leave a camera's selected pictures where they are; none is opened.

    Args:
        stream: the camera.
        selected: (N,) ascending indices into the stream.
        advance: called with the number of pictures.
    """
    uris, sizes = [stream.uris[index] for index in selected.tolist()], stream.byte_length[selected]
    advance(len(uris))
    nothing: list[bytes | None] = [None] * len(uris)
    width, height = stream.width_px[selected], stream.height_px[selected]
    return Placed(uris, sizes.tolist(), nothing, stream.codec, width, height, 0)


def place_pictures(
    stream: ImageStream,
    selected: Int64,
    stamps_ns: Int64,
    folder: Path,
    *,
    transfer: Transfer,
    hashing: bool,
    advance: Callable[[int], None],
) -> Placed:
    """Put a camera's selected pictures into a folder.

    Args:
        stream: the camera.
        selected: (N,) ascending indices into the stream.
        stamps_ns: (N,) their mid-exposure stamps, which name the files.
        folder: made here.
        transfer: hard links where the file systems allow it and copies elsewhere, or always copies.
        hashing: read every byte: hash it, and refuse truncated pictures.
        advance: called with the number of pictures done since the last call.

    Returns:
        What lies in the folder now.

    Raises:
        RecordingError: a picture is missing, truncated or no picture.
        DatasetError: the folder cannot be written.
    """
    codec = stream.codec if stream.codec in _SUFFIX else "jpeg"
    suffix = _SUFFIX[codec]
    names = [f"{stamp}.{suffix}" for stamp in stamps_ns.tolist()]
    indices: Sequence[int] = selected.tolist()
    try:
        folder.mkdir(parents=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise unwritable(folder, error) from error
    try:
        return _place(stream, indices, names, _Target(folder, descriptor), codec, transfer, hashing, advance)
    finally:
        os.close(descriptor)


@dataclass(frozen=True)
class _Target:
    """A folder that is written to, with its descriptor: names in it are looked up from there."""

    path: Path
    descriptor: int


def _place(
    stream: ImageStream,
    indices: Sequence[int],
    names: list[str],
    target: _Target,
    codec: str,
    transfer: Transfer,
    hashing: bool,
    advance: Callable[[int], None],
) -> Placed:
    sizes: list[int] = []
    digests: list[bytes | None] = []
    linked, width, height = 0, 0, 0
    own_files = stream.path(indices[0]) is not None
    if own_files:
        width, height = _first_size(stream.path(indices[0]))
        for index, name in zip(indices, names):
            source = stream.path(index)
            if source is None:
                raise RecordingError("the picture has no file, though others of its camera do", place=f"image {index}")
            size, digest, was_linked = _transfer(source, target, name, transfer, hashing)
            sizes.append(size)
            digests.append(digest)
            linked += was_linked
            if len(sizes) % _TOLD_EVERY == 0:
                advance(_TOLD_EVERY)
    else:
        given: dict[int, tuple[int, bytes | None]] = {}
        name_of = dict(zip(indices, names))
        for index, data in stream.read(indices):
            if index not in name_of or index in given:
                raise RecordingError(f"gave picture {index} unasked or twice", place=f"camera {stream.camera}")
            if not given:
                width, height = raster_size(data, f"{stream.camera} at {name_of[index]}")
            _write(target, name_of[index], data)
            given[index] = len(data), hashlib.sha256(data).digest() if hashing else None
            if len(given) % _TOLD_EVERY == 0:
                advance(_TOLD_EVERY)
        for index in indices:
            if index in given:
                size, digest = given[index]
                sizes.append(size)
                digests.append(digest)
    advance(len(sizes) % _TOLD_EVERY)
    if len(sizes) != len(indices):
        raise RecordingError(f"gave {len(sizes)} of {len(indices)} pictures", place=f"camera {stream.camera}")
    widths, heights = np.full(len(sizes), width), np.full(len(sizes), height)
    return Placed(names, sizes, digests, codec, widths, heights, linked)


def _first_size(source: str | Path | None) -> tuple[int, int]:
    if source is None:
        raise RecordingError("the picture has no file")
    return raster_size(_read(source), source)


def _transfer(
    source: str | Path, target: _Target, name: str, transfer: Transfer, hashing: bool
) -> tuple[int, bytes | None, bool]:
    """Link or copy one picture; its size, its digest if asked for, and whether it is a link."""
    if transfer == "link":
        try:
            # With a descriptor, the file that a symbolic link stands for is linked, and not the symbolic link.
            os.link(source, name, dst_dir_fd=target.descriptor)
        except FileNotFoundError as error:
            raise _unreadable(source, error) from error
        except OSError as error:
            if error.errno not in _NOT_LINKABLE:
                raise unwritable(target.path / name, error) from error
        else:
            if not hashing:
                return os.stat(name, dir_fd=target.descriptor).st_size, None, True
            data = _read(source)
            require_whole(data, source)
            return len(data), hashlib.sha256(data).digest(), True
    data = _read(source)
    require_whole(data, source)
    digest = hashlib.sha256(data).digest() if hashing else None
    _write(target, name, data)
    return len(data), digest, False


def _read(source: str | Path) -> bytes:
    try:
        descriptor = os.open(source, os.O_RDONLY)
    except OSError as error:
        raise _unreadable(source, error) from error
    try:
        size = os.fstat(descriptor).st_size
        data = os.read(descriptor, size)
        while len(data) < size and (more := os.read(descriptor, size - len(data))):
            data += more
        return data
    except OSError as error:
        raise _unreadable(source, error) from error
    finally:
        os.close(descriptor)


def _write(target: _Target, name: str, data: bytes) -> None:
    try:
        descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644, dir_fd=target.descriptor)
        try:
            view = memoryview(data)
            while view:
                view = view[os.write(descriptor, view) :]
        finally:
            os.close(descriptor)
    except OSError as error:
        raise unwritable(target.path / name, error) from error


def _unreadable(source: str | Path, error: OSError) -> RecordingError:
    return RecordingError(
        f"cannot be read: {error.strerror}",
        file=source,
        expected="a picture",
        remedy="restore the file, or take it out of the recording",
    )
