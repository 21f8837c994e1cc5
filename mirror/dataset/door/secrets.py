"""Contents that must not leave: the hashes of its bytes, of its pixels and of the packets of its videos."""

from __future__ import annotations

import hashlib
import io
import threading
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Final

from mirror.dataset.door.files import ImageFile, ImageKey
from mirror.dataset.door.plan import Departure, KeptFile, Why
from mirror.dataset.door.search import ByteSearch
from mirror.dataset.images.decoding import decode_rgb
from mirror.dataset.store import Store
from mirror.pools import thread_pool
from mirror.progress import ProgressReporter

if TYPE_CHECKING:
    from mirror.arrays import UInt8

_THREADS: Final = 8
_SMALLEST_PACKET: Final = 64
"""Packets below this size say that nothing moved; many frames have the same."""


class Secrets:
    """The contents that must not leave the dataset.

    Args:
        store: the dataset.
        departure: what leaves it and what stays.
        progress: receives the progress.

    Attributes:
        bytes: files that stay, by the SHA-256 of their bytes.
        search: finds these bytes inside others.
        shown: the images that leave, by the SHA-256 of their bytes.
    """

    def __init__(self, store: Store, departure: Departure, progress: ProgressReporter) -> None:
        self.bytes: dict[str, KeptFile] = {}
        self.search = ByteSearch()
        self.shown: dict[str, ImageKey] = {}
        self._store = store
        self._sizes: dict[tuple[int, int], list[KeptFile]] = {}
        self._videos: dict[str, dict[int | None, KeptFile]] = {}
        self._departure = departure
        self._pixels: dict[tuple[int, int], dict[str, KeptFile]] = {}
        self._lock = threading.Lock()
        for key, one in departure.shown.items():
            if one.sha256 is not None:
                self.shown.setdefault(one.sha256, key)
        parts: dict[tuple[str, int, int, str | None], KeptFile] = {}
        for kept in departure.kept:
            one = kept.file
            parts.setdefault((one.name, one.offset, one.length, one.sha256), kept)
            if one.codec == "video":
                self._videos.setdefault(one.name, {})[one.pts] = kept
            else:
                self._sizes.setdefault(one.size, []).append(kept)
        progress.start("hashing what stays", len(parts))
        with thread_pool(_THREADS) as pool:
            for kept, data in zip(parts.values(), pool.map(self._read, parts.values())):
                self._add(kept, data)
                progress.advance(1)

    def pixels(self, size: tuple[int, int]) -> Mapping[str, KeptFile]:
        """Return the SHA-256 of the pixels of images that must stay, if they have a size; decoded on first use."""
        with self._lock:
            if size not in self._pixels:
                self._pixels[size] = dict(self._hash_pixels(size))
            return self._pixels[size]

    def packets(self) -> Mapping[str, KeptFile]:
        """Return the SHA-256 of the packets of video frames that must stay."""
        found: dict[str, KeptFile] = {}
        for frames in self._videos.values():
            data = self._read(next(iter(frames.values())))
            packets = video_packets(data) if data else ()
            found |= {digest: frames[pts] for pts, digest in packets if pts in frames}
        return found

    def _read(self, kept: KeptFile) -> bytes:
        """The bytes of a file; none where it is missing: its hash in the table remains."""
        if not kept.file.length:
            return b""
        try:
            return self._store.read_range(kept.file.name, kept.file.offset, kept.file.length)
        except FileNotFoundError:
            return b""

    def _add(self, kept: KeptFile, data: bytes) -> None:
        found = hashlib.sha256(data).hexdigest() if data else None
        for digest in (kept.file.sha256, found):
            if digest is None or self._is_unchanged(kept, digest):
                continue
            self.bytes.setdefault(digest, kept)
            if digest == found:
                self.search.add(data, digest)

    def _is_unchanged(self, kept: KeptFile, sha256: str) -> bool:
        """Return whether bytes are those of an image that a redaction did not change: they leave."""
        return kept.why is Why.ORIGINAL and self._departure.shown[kept.file.key].sha256 == sha256

    def _hash_pixels(self, size: tuple[int, int]) -> Iterator[tuple[str, KeptFile]]:
        for kept in self._sizes.get(size, ()):
            if kept.file.layer.startswith("depth/"):
                continue
            digest = self._hash_of_pixels(kept.file)
            if digest is None:
                continue
            if kept.why is Why.ORIGINAL and self._hash_of_pixels(self._departure.shown[kept.file.key]) == digest:
                # Only its metadata was removed.
                continue
            yield digest, kept

    def _hash_of_pixels(self, one: ImageFile) -> str | None:
        pixels = decode_rgb(self._read(KeptFile(one, Why.WITHHELD)), one.codec)
        return None if pixels is None else pixel_hash(pixels)


def pixel_hash(pixels: UInt8) -> str:
    """Return the SHA-256 of decoded pixels."""
    return hashlib.sha256(pixels.tobytes()).hexdigest()


def video_packets(data: bytes) -> Iterator[tuple[int | None, str]]:
    """Yield the time stamp and SHA-256 of each packet of a video, except nearly empty packets."""
    import av

    with av.open(io.BytesIO(data), "r") as container:
        for packet in container.demux(video=0):
            content = bytes(packet)
            if len(content) >= _SMALLEST_PACKET:
                yield packet.pts, hashlib.sha256(content).hexdigest()


def describe(one: ImageFile) -> str:
    """Return an image in words: ``traversal/camera/timestamp_ns``."""
    return "/".join(map(str, one.key))
