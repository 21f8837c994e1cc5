"""The inspection at the door: every file that is about to leave is hashed and held against what must not leave."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

from mirror.dataset.door.contents import contents
from mirror.dataset.door.files import RECORDED, ImageFile, ImageKey
from mirror.dataset.door.plan import Departure, KeptFile, Why
from mirror.dataset.door.secrets import Secrets, describe, pixel_hash, video_packets
from mirror.dataset.images.decoding import decode_rgb
from mirror.pools import thread_pool
from mirror.progress import ProgressReporter
from mirror.schema.documents import FileEntry
from mirror.schema.links import require_inside

_THREADS: Final = 8
_JPEG: Final = b"\xff\xd8\xff"
_PNG: Final = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPE: Final = 25
"""Byte of a PNG that states whether it is grey or coloured."""
_GREY: Final = 0
_VIDEOS: Final = frozenset({".mp4", ".mov", ".mkv", ".avi", ".webm", ".h264", ".h265", ".hevc", ".ts"})


class Leak(NamedTuple):
    """A file that must not leave the dataset in its present state.

    Attributes:
        file: path of the file.
        problem: what is wrong with it.
    """

    file: str
    problem: str


class SameBytes(NamedTuple):
    """An image that may leave and has the same bytes as one that must stay, such as two images of a parked car.

    Attributes:
        shown: the image that leaves, ``traversal/camera/timestamp_ns``.
        kept: the image that stays.
        why: why it stays.
    """

    shown: str
    kept: str
    why: str


@dataclass(frozen=True, eq=False)
class Inspection:
    """The result of an inspection.

    Attributes:
        leaks: why the files must not leave; empty: they may.
        same_bytes: images that leave with the bytes of images that stay.
        entries: size and SHA-256 of every file, by path.
    """

    leaks: Sequence[Leak]
    same_bytes: Sequence[SameBytes]
    entries: Mapping[str, FileEntry]


def read_below(root: Path) -> Callable[[str], bytes]:
    """Return a function that reads files below a folder and follows no link out of it."""
    return lambda name: require_inside(root, name).read_bytes()


def inspect_files(
    read: Callable[[str], bytes],
    names: Iterable[str],
    departure: Departure,
    secrets: Secrets,
    progress: ProgressReporter,
    *,
    stated: Mapping[str, str] | None = None,
) -> Inspection:
    """Hash files and their parts, and compare them with the content that must stay in the dataset.

    Args:
        read: reads a file.
        names: paths of the files; those of images that leave are the dataset's own.
        departure: what may leave.
        secrets: what must not leave.
        progress: receives the progress.
        stated: the SHA-256 that files must have.

    Raises:
        DatasetError: a link leads out of the folder.
    """
    shown: dict[str, list[ImageFile]] = {}
    for one in departure.shown.values():
        shown.setdefault(one.name, []).append(one)
    door = _Door(stated or {}, shown, departure, secrets)
    chosen = sorted(names)
    progress.start("inspecting", len(chosen))
    entries, leaks, same = {}, [], dict[SameBytes, None]()

    def look(name: str) -> tuple[FileEntry, list[Leak | SameBytes]]:
        data = read(name)
        entry = FileEntry(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
        found = list(door.findings(name, data, entry.sha256))
        progress.advance(1)
        return entry, found

    with thread_pool(_THREADS) as pool:
        for name, (entry, found) in zip(chosen, pool.map(look, chosen)):
            entries[name] = entry
            leaks += [one for one in found if isinstance(one, Leak)]
            same |= dict.fromkeys(one for one in found if isinstance(one, SameBytes))
    return Inspection(tuple(leaks), tuple(same), entries)


class _Door:
    """Inspects one file after the other."""

    def __init__(
        self,
        stated: Mapping[str, str],
        shown: Mapping[str, Sequence[ImageFile]],
        departure: Departure,
        secrets: Secrets,
    ) -> None:
        self._stated = stated
        self._departure = departure
        self._shown = shown
        self._secrets = secrets
        self._packets = secrets.packets()

    def findings(self, name: str, data: bytes, sha256: str) -> Iterator[Leak | SameBytes]:
        """Find what is wrong with a file, and the images in it that have the bytes of others."""
        if self._stated.get(name, sha256) != sha256:
            yield Leak(name, "other bytes than its source has, or than its table or manifest states")
            taken_down = Why.TAKEN_DOWN.value
            yield from (one for one in self._held(name, data, sha256) if isinstance(one, Leak) and taken_down in one[1])
            return
        yield from self._held(name, data, sha256)

    def _held(self, name: str, data: bytes, sha256: str) -> Iterator[Leak | SameBytes]:
        yield from self._known(name, "", sha256)
        if sha256 in self._secrets.bytes or self._is_one_image(name):
            return
        yield from self._inside(name, "", data)
        try:
            for place, piece in contents(data):
                digest = hashlib.sha256(piece).hexdigest()
                yield from self._known(name, f"{place} has ", digest)
                if digest not in self._secrets.bytes:
                    yield from self._inside(name, f"{place} has ", piece)
        except ValueError as error:
            yield Leak(name, f"{error}: nothing states what it holds")

    def _is_one_image(self, name: str) -> bool:
        """Return whether a file is one image that leaves, and nothing else: its hash decides."""
        own = self._shown.get(name, ())
        return len(own) == 1 and own[0].codec != "video" and own[0].offset == 0

    def _known(self, name: str, place: str, sha256: str) -> Iterator[Leak | SameBytes]:
        kept = self._secrets.bytes.get(sha256)
        if kept is not None:
            yield self._same(name, place, "the bytes of ", sha256, kept)

    def _same(self, name: str, place: str, what: str, sha256: str, kept: KeptFile) -> Leak | SameBytes:
        """Bytes that must not leave; they may where a published image has them, unless it shows a face as recorded."""
        key = self._secrets.shown.get(sha256)
        if key is not None and not (kept.why is Why.ORIGINAL and self._is_recorded(key)):
            return SameBytes("/".join(map(str, key)), describe(kept.file), kept.why.value)
        return Leak(name, f"{place}{what}{kept.why.value}: {describe(kept.file)}")

    def _is_recorded(self, key: ImageKey) -> bool:
        return self._departure.shown[key].layer == RECORDED

    def _inside(self, name: str, place: str, data: bytes) -> Iterator[Leak | SameBytes]:
        """Secrets inside bytes: byte strings, the pixels of an image, and packets of a video."""
        for start, _, sha256 in self._secrets.search.find(data):
            kept = self._secrets.bytes[sha256]
            yield self._same(name, f"{place}at byte {start} ", "the bytes of ", sha256, kept)
        codec = "jpeg" if data.startswith(_JPEG) else "png" if data.startswith(_PNG) else None
        if codec is not None:
            yield from self._pixels(name, place, data, codec)
        elif PurePosixPath(name).suffix.lower() in _VIDEOS and self._packets:
            own = {one.pts: one for one in self._shown.get(name, ())}
            for pts, digest in video_packets(data):
                same = self._packets.get(digest)
                if same is not None and pts in own:
                    yield SameBytes(describe(own[pts]), describe(same.file), same.why.value)
                elif same is not None:
                    yield Leak(name, f"{place}a frame of {same.why.value}: {describe(same.file)}")

    def _pixels(self, name: str, place: str, data: bytes, codec: str) -> Iterator[Leak]:
        if codec == "png" and data[_COLOUR_TYPE] == _GREY:
            # A mask or a depth map.
            return
        pixels = decode_rgb(data, codec)
        if pixels is None:
            return
        kept = self._secrets.pixels((pixels.shape[1], pixels.shape[0])).get(pixel_hash(pixels))
        if kept is not None and kept.file.sha256 not in self._secrets.shown:
            yield Leak(name, f"{place}the pixels of {kept.why.value}: {describe(kept.file)}")
