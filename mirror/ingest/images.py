"""Images of a traversal: linked or copied byte for byte, never re-encoded, hashed on the way; or referred to."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from mirror.arrays import Int64
from mirror.dataset.images.decoding import decode_rgb
from mirror.errors import RecordingError
from mirror.ingest.references import References, identify_references
from mirror.recordings.opening import read_file, read_file_start, unreadable_error
from mirror.recordings.protocol import ImageStream, ReferencedStream
from mirror.recordings.raster import read_raster_size, require_complete_image
from mirror.schema.files import unwritable_error

Transfer = Literal["link", "copy"]
_SUFFIX = {"jpeg": "jpg", "png": "png"}
_TOLD_EVERY = 16
_HEADER_BYTES = 4096
_NOT_LINKABLE = (errno.EXDEV, errno.EPERM, errno.EMLINK, errno.ENOTSUP)


@dataclass(frozen=True)
class PlacedImages:
    """The N images of one camera of a traversal.

    Attributes:
        names: file names in the camera's folder, or absolute uris; the frames of one video have one name.
        sizes: bytes of each; of a frame of a video, those of the video.
        sha256: digest of each file, or None where hashing is off or the images lie elsewhere.
        codec: ``jpeg``, ``png`` or ``video``.
        width_px: (N,) of each, as its header says.
        height_px: (N,) of each.
        linked: how many are hard links to the recording's own files.
        video_pts: (N,) time stamps of the frames of videos; None: the images are not in videos.
        etags: tags of images that lie elsewhere, by uri.
    """

    names: list[str]
    sizes: list[int]
    sha256: list[bytes | None]
    codec: str
    width_px: Int64
    height_px: Int64
    linked: int
    video_pts: Int64 | None = None
    etags: Mapping[str, str] = field(default_factory=dict)

    @property
    def bytes(self) -> int:
        """Bytes of all files."""
        return sum(self.sizes) if self.video_pts is None else sum(dict(zip(self.names, self.sizes)).values())


def refer_to_images(
    stream: ReferencedStream, selected: Int64, advance: Callable[[int], None], keep: References = "size"
) -> PlacedImages:
    """Refer to a camera's selected images at their present place.

    Args:
        stream: the camera.
        selected: (N,) ascending indices into the stream.
        advance: called with the number of images done since the last call.
        keep: what is kept of their bytes; for their sizes, no image is asked for.

    Raises:
        RecordingError: an image cannot be fetched, has another size than its row says, or no ETag.
    """
    uris, sizes = [stream.uris[index] for index in selected.tolist()], stream.byte_length[selected]
    found = identify_references(stream, selected, keep, advance)
    width, height = stream.width_px[selected], stream.height_px[selected]
    etags = {uri: one.etag for uri, one in zip(uris, found) if one.etag is not None}
    hashes = [one.sha256 for one in found]
    return PlacedImages(uris, sizes.tolist(), hashes, stream.codec, width, height, 0, etags=etags)


def place_images(
    stream: ImageStream,
    selected: Int64,
    stamps_ns: Int64,
    folder: Path,
    *,
    transfer: Transfer,
    hashing: bool,
    decoding: bool = False,
    advance: Callable[[int], None],
) -> PlacedImages:
    """Put a camera's selected images into a folder.

    Args:
        stream: the camera.
        selected: (N,) ascending indices into the stream.
        stamps_ns: (N,) their mid-exposure stamps, which name the files.
        folder: made here.
        transfer: hard links where the file systems allow it and copies elsewhere, or always copies.
        hashing: read every byte: hash it, and refuse images whose structure is broken; else only headers are read.
        decoding: decode every image, and refuse those that no decoder reads.
        advance: called with the number of images done since the last call.

    Returns:
        What lies in the folder now.

    Raises:
        RecordingError: an image is missing, truncated, broken or no image.
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
        raise unwritable_error(folder, error) from error
    try:
        inspection = _Inspection(codec, hashing, decoding)
        return _place(stream, indices, names, _Target(folder, descriptor), transfer, inspection, advance)
    finally:
        os.close(descriptor)


@dataclass(frozen=True)
class _Target:
    """A folder that is written to, with its descriptor: names in it are looked up from there."""

    path: Path
    descriptor: int


@dataclass(frozen=True)
class _Image:
    """What is known of one placed image."""

    size: int
    sha256: bytes | None
    width_px: int
    height_px: int


@dataclass(frozen=True)
class _Inspection:
    """How images are inspected on their way; see `place_images`."""

    codec: str
    hashing: bool
    decoding: bool

    @property
    def headers_only(self) -> bool:
        """No byte behind the headers is wanted."""
        return not (self.hashing or self.decoding)

    def bytes_of(self, data: bytes, file: str | Path) -> _Image:
        """Inspect an image's bytes."""
        width, height = require_complete_image(data, file)
        if self.decoding:
            pixels = decode_rgb(data, self.codec)
            if pixels is None or pixels.shape[:2] != (height, width):
                raise RecordingError(
                    "cannot be decoded",
                    file=file,
                    expected=f"an image of {width} x {height} px, as its header says",
                    remedy="restore the file, or take it out of the recording",
                )
        return _Image(len(data), hashlib.sha256(data).digest() if self.hashing else None, width, height)


def _place(
    stream: ImageStream,
    indices: Sequence[int],
    names: list[str],
    target: _Target,
    transfer: Transfer,
    inspection: _Inspection,
    advance: Callable[[int], None],
) -> PlacedImages:
    given: dict[int, _Image] = {}
    linked = 0
    if stream.path(indices[0]) is not None:
        for index, name in zip(indices, names):
            source = stream.path(index)
            if source is None:
                raise RecordingError(
                    "the image has no file, though others of its camera do",
                    place=f"image {index}",
                    remedy="mend the reader: all images of a camera have files, or none",
                )
            given[index], was_linked = _transfer(source, target, name, transfer, inspection)
            linked += was_linked
            if len(given) % _TOLD_EVERY == 0:
                advance(_TOLD_EVERY)
    else:
        name_of = dict(zip(indices, names))
        for index, data in stream.read(indices):
            if index not in name_of or index in given:
                raise RecordingError(
                    f"gave image {index} unasked or twice",
                    place=f"camera {stream.camera}",
                    remedy="mend the reader: it gives each image that is asked for, once",
                )
            given[index] = inspection.bytes_of(data, f"{stream.camera} at {name_of[index]}")
            _write(target, name_of[index], data)
            if len(given) % _TOLD_EVERY == 0:
                advance(_TOLD_EVERY)
    advance(len(given) % _TOLD_EVERY)
    if len(given) != len(indices):
        raise RecordingError(
            f"gave {len(given)} of {len(indices)} images",
            place=f"camera {stream.camera}",
            remedy="mend the reader: it gives each image that is asked for, once",
        )
    images = [given[index] for index in indices]
    return PlacedImages(
        names,
        [one.size for one in images],
        [one.sha256 for one in images],
        inspection.codec,
        np.array([one.width_px for one in images], np.int64),
        np.array([one.height_px for one in images], np.int64),
        linked,
    )


def _transfer(
    source: str | Path, target: _Target, name: str, transfer: Transfer, inspection: _Inspection
) -> tuple[_Image, bool]:
    """Link or copy one image; what is known of it, and whether it is a link."""
    if transfer == "link":
        try:
            # With a descriptor, the file that a symbolic link stands for is linked, and not the symbolic link.
            os.link(source, name, dst_dir_fd=target.descriptor)
        except FileNotFoundError as error:
            raise unreadable_error(Path(source), error) from error
        except OSError as error:
            if error.errno not in _NOT_LINKABLE:
                raise unwritable_error(target.path / name, error) from error
        else:
            if inspection.headers_only:
                return _header(source), True
            return inspection.bytes_of(read_file(source), source), True
    data = read_file(source)
    image = inspection.bytes_of(data, source)
    _write(target, name, data)
    return image, False


def _header(source: str | Path) -> _Image:
    """An image of which its header alone is read, or what comes before it if that is long."""
    data, size = read_file_start(source, _HEADER_BYTES)
    try:
        width, height = read_raster_size(data, source)
    except RecordingError:
        width, height = read_raster_size(read_file(source), source)
    return _Image(size, None, width, height)


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
        raise unwritable_error(target.path / name, error) from error
