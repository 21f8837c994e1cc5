"""Keeps sizes, ETags or hashes of images that a recording refers to by uri.

None of them is copied. Hashes take a transfer of all bytes, once; ETags take a request an image and no transfer.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, Literal, NamedTuple, TypeVar

from mirror.arrays import Int64
from mirror.dataset.uris import resolve_uri, uri_etag
from mirror.errors import DatasetError, RecordingError
from mirror.recordings.protocol import ReferencedStream
from mirror.recordings.raster import require_complete_image

References = Literal["size", "etag", "sha256"]
_REQUESTS: Final = 16
Result = TypeVar("Result")


class Reference(NamedTuple):
    """A hash or tag of the bytes of an image elsewhere.

    Attributes:
        sha256: their hash.
        etag: the tag that their store gave them.
    """

    sha256: bytes | None = None
    etag: str | None = None


def identify_references(
    stream: ReferencedStream, selected: Int64, keep: References, advance: Callable[[int], None]
) -> list[Reference]:
    """Ask for the hashes or tags of a camera's selected images; for their sizes alone, nothing is asked.

    Args:
        stream: the camera.
        selected: (N,) ascending indices into the stream.
        keep: what is kept of them.
        advance: called with the number of images done since the last call.

    Raises:
        RecordingError: an image cannot be fetched, has another size than its row says, or no ETag.
    """
    if keep == "size":
        advance(len(selected))
        return [Reference()] * len(selected)

    def identify(index: int) -> Reference:
        found = _hash(stream, index) if keep == "sha256" else _tag(stream, index)
        advance(1)
        return found

    with ThreadPoolExecutor(_REQUESTS) as pool:
        return list(pool.map(identify, selected.tolist()))


def _hash(stream: ReferencedStream, index: int) -> Reference:
    uri = stream.uris[index]
    data = bytes(_ask(stream, index, lambda filesystem, path: filesystem.cat_file(path)))
    _require_size(stream, index, len(data))
    width, height = require_complete_image(data, uri)
    if (width, height) != (stream.width_px[index], stream.height_px[index]):
        raise RecordingError(
            f"{width} x {height} px", file=uri, place=f"camera {stream.camera}",
            expected=f"{stream.width_px[index]} x {stream.height_px[index]} px, as its row says",
            remedy="correct the row",
        )  # fmt: skip
    return Reference(sha256=hashlib.sha256(data).digest())


def _tag(stream: ReferencedStream, index: int) -> Reference:
    entry = _ask(stream, index, lambda filesystem, path: filesystem.info(path))
    _require_size(stream, index, int(entry["size"]))
    etag = uri_etag(entry)
    if etag is None:
        raise RecordingError(
            "its store gives no ETag", file=stream.uris[index], place=f"camera {stream.camera}",
            expected="S3, or a web server that sends ETags", remedy="give --references sha256, or size",
        )  # fmt: skip
    return Reference(etag=etag)


def _ask(stream: ReferencedStream, index: int, ask: Callable[[Any, str], Result]) -> Result:
    uri = stream.uris[index]
    try:
        return ask(*resolve_uri(uri))
    except (OSError, ValueError, DatasetError) as error:
        raise RecordingError(
            f"cannot be fetched: {error}", file=uri, place=f"camera {stream.camera}",
            expected="an image that fsspec reads with the packages installed here",
            remedy="restore it, or give --references size, which asks for none",
        ) from error  # fmt: skip


def _require_size(stream: ReferencedStream, index: int, size: int) -> None:
    if size != stream.byte_length[index]:
        raise RecordingError(
            f"has {size:,} bytes", file=stream.uris[index], place=f"camera {stream.camera}",
            expected=f"{stream.byte_length[index]:,} bytes, as its row says", remedy="correct the row",
        )  # fmt: skip
