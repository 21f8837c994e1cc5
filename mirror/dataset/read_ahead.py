"""Reading of images that lie far away, before they are needed: neighbours in one request, several requests at a time.

A request to a bucket takes tens of milliseconds whatever it brings. The ranges of the next frames are sorted by their
place, those that lie side by side are read as one span, and a bounded number of bytes is held. What is read, and in
which order it is used, does not depend on any of it.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Final, NamedTuple, TypeVar

from mirror.dataset.store import Store

Group = TypeVar("Group")

WINDOW_BYTES: Final = 128 << 20
"""Bytes of images that are held or on their way."""

WINDOW_IMAGES: Final = 1024
"""Images that are held or on their way."""

_SPAN_BYTES: Final = 8 << 20
_GAP_BYTES: Final = 4 << 10
"""Bytes between two images that are read with them: names and padding of an archive take up to 1 KiB."""

_REQUESTS: Final = 16


class ByteRange(NamedTuple):
    """A part of a file.

    Attributes:
        uri: the file.
        offset: first byte.
        length: number of bytes.
        is_whole: it is a file of its own outside of the dataset, whose size and tag must not have changed.
        etag: the tag of that file; None: it is not known.
    """

    uri: str
    offset: int
    length: int
    is_whole: bool = False
    etag: str | None = None

    def read(self, store: Store) -> bytes:
        """Read it.

        Raises:
            DatasetError: as `Store.read_range` and `Store.read_whole`.
            OSError: the file cannot be read.
        """
        if self.is_whole:
            return store.read_whole(self.uri, self.length, self.etag)
        return store.read_range(self.uri, self.offset, self.length)


class Span(NamedTuple):
    """Ranges of one file that are read together.

    Attributes:
        uri: the file.
        start: first byte.
        end: byte after the last one.
        ranges: the ranges in it.
    """

    uri: str
    start: int
    end: int
    ranges: tuple[ByteRange, ...]


def coalesce(ranges: Iterable[ByteRange], *, gap_bytes: int = _GAP_BYTES, limit_bytes: int = _SPAN_BYTES) -> list[Span]:
    """Join ranges that lie side by side, sorted by file and place.

    Args:
        ranges: of any files, in any order.
        gap_bytes: most bytes between two ranges that are read for nothing.
        limit_bytes: most bytes of a span with more than one range.
    """
    spans: list[Span] = []
    for one in sorted(set(ranges), key=lambda one: one[:3]):
        end = one.offset + one.length
        if spans:
            last = spans[-1]
            is_near = last.uri == one.uri and not one.is_whole and one.offset - last.end <= gap_bytes
            if is_near and max(end, last.end) - last.start <= limit_bytes:
                spans[-1] = Span(last.uri, last.start, max(end, last.end), (*last.ranges, one))
                continue
        spans.append(Span(one.uri, one.offset, end, (one,)))
    return spans


class ReadAhead:
    """Bytes that were asked for before they are needed.

    Args:
        store: the dataset's files.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._held: dict[ByteRange, tuple[Future[bytes], int]] = {}
        self._pool: ThreadPoolExecutor | None = None

    def is_far(self, uri: str) -> bool:
        """Return whether a file is not on a disk of this machine."""
        return (self._store.folder is None and not uri.startswith(("/", "file://"))) or (
            "://" in uri and not uri.startswith("file://")
        )

    def request(self, ranges: Iterable[ByteRange]) -> None:
        """Begin to read ranges; those that are held already are not read again."""
        with self._lock:
            missing = [one for one in ranges if one not in self._held]
            if missing and self._pool is None:
                self._pool = ThreadPoolExecutor(_REQUESTS, thread_name_prefix="mirror-read-ahead")
            for span in coalesce(missing):
                if self._pool is None:
                    break
                future = self._pool.submit(_read_span, self._store, span)
                for one in span.ranges:
                    self._held[one] = future, one.offset - span.start

    def take(self, uri: str, offset: int, length: int, is_whole: bool = False, etag: str | None = None) -> bytes | None:
        """Return the bytes of a range that was asked for; None: it was not.

        Raises:
            DatasetError: as `Store.read_range`.
            OSError: the file cannot be read.
        """
        with self._lock:
            held = self._held.get(ByteRange(uri, offset, length, is_whole, etag))
        if held is None:
            return None
        future, start = held
        return future.result()[start : start + length]

    def release(self, ranges: Iterable[ByteRange]) -> None:
        """Forget ranges that were used."""
        with self._lock:
            for one in ranges:
                self._held.pop(one, None)

    @contextmanager
    def reading(self, ranges: Sequence[ByteRange]) -> Iterator[None]:
        """Read ranges together that the block uses."""
        far = [one for one in ranges if self.is_far(one.uri)]
        if len(far) > 1:
            self.request(far)
        try:
            yield
        finally:
            self.release(far)

    def over(
        self,
        groups: Iterable[Group],
        find_ranges: Callable[[Group], Sequence[ByteRange]],
        *,
        window_bytes: int = WINDOW_BYTES,
        window_images: int = WINDOW_IMAGES,
    ) -> Iterator[Group]:
        """Yield groups, such as frames or batches, while the ranges of the next ones are being read.

        The window is filled again when half of it was used, so that neighbours in it are read together.

        Args:
            groups: in the order in which they are used.
            find_ranges: returns the ranges of a group.
            window_bytes: most bytes that are held or on their way; one group is read whatever it takes.
            window_images: most ranges that are held or on their way.
        """
        remaining = iter(groups)
        waiting: deque[tuple[Group, Sequence[ByteRange]]] = deque()
        size = count = 0
        is_at_end = False
        try:
            while True:
                if not is_at_end and 2 * size <= window_bytes and 2 * count <= window_images:
                    begun = len(waiting)
                    while not waiting or (size < window_bytes and count < window_images):
                        group = next(remaining, None)
                        if group is None:
                            is_at_end = True
                            break
                        ranges = find_ranges(group)
                        waiting.append((group, ranges))
                        size += sum(one.length for one in ranges)
                        count += len(ranges)
                    new = list(waiting)[begun:]
                    self.request(one for _, ranges in new for one in ranges)
                if not waiting:
                    return
                group, ranges = waiting.popleft()
                try:
                    yield group
                finally:
                    self.release(ranges)
                size -= sum(one.length for one in ranges)
                count -= len(ranges)
        finally:
            for _, ranges in waiting:
                self.release(ranges)


def _read_span(store: Store, span: Span) -> bytes:
    if len(span.ranges) == 1:
        return span.ranges[0].read(store)
    return store.read_range(span.uri, span.start, span.end - span.start)
