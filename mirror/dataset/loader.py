"""Reads traversals, rigs, masks and images for the frames of a view, and keeps what several frames need."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Collection
from functools import cached_property
from typing import TYPE_CHECKING, Final

import pyarrow as pa

from mirror.arrays import Float32, UInt8
from mirror.dataset.layers import LayerChoice
from mirror.dataset.query.catalog import Catalog
from mirror.dataset.read_ahead import ByteRange, ReadAhead
from mirror.dataset.store import Store
from mirror.dataset.traversal import Traversal
from mirror.dataset.withheld import image_remedy
from mirror.errors import DatasetError
from mirror.schema.documents import Rig

if TYPE_CHECKING:
    from mirror.dataset.images.video_decoders import VideoDecoders

_TRAVERSALS_HELD: Final = 64


class Loader:
    """A reader of the files of all frames of one sequence.

    Args:
        catalog: the index.
        layers: the layers to read.
        cameras: the cameras of the view; None: all.

    Attributes:
        catalog: the index.
        store: the dataset's files.
        read_ahead: bytes that were asked for before they are needed.
    """

    def __init__(self, catalog: Catalog, layers: LayerChoice, cameras: frozenset[str] | None) -> None:
        self.catalog = catalog
        self.store: Store = catalog.store
        self.read_ahead = ReadAhead(self.store)
        self._layers = layers
        self._cameras = cameras
        self._traversals: OrderedDict[int, Traversal] = OrderedDict()
        self._rigs: dict[str, Rig] = {}
        self._static_masks: dict[tuple[str, str], UInt8 | None] = {}
        self._intact_videos: set[tuple[str, int, int, bytes]] = set()
        self._lock = threading.Lock()

    @cached_property
    def _keys(self) -> pa.Table:
        return self.catalog.read_global("traversals", ["scene_id", "traversal_id", "rig_id"])

    @cached_property
    def _videos(self) -> VideoDecoders:
        from mirror.dataset.images.video_decoders import VideoDecoders

        return VideoDecoders(self.store)

    def traversal(self, row: int) -> tuple[str, Traversal]:
        """Return the scene id and traversal for a row of the table of traversals."""
        with self._lock:
            if row not in self._traversals:
                traversal_id = self._keys.column("traversal_id")[row].as_py()
                self._traversals[row] = Traversal(self.catalog, row, traversal_id, self._layers)
                if len(self._traversals) > _TRAVERSALS_HELD:
                    self._traversals.popitem(last=False)
            self._traversals.move_to_end(row)
            return self._keys.column("scene_id")[row].as_py(), self._traversals[row]

    def rig(self, row: int) -> Rig | None:
        """Return the rig of a traversal; None if its drive has no cameras.

        Raises:
            DatasetError: the rig's file is missing.
        """
        rig_id = self._keys.column("rig_id")[row].as_py()
        if rig_id is None:
            return None
        if rig_id not in self._rigs:
            self._rigs[rig_id] = self.store.json(f"rigs/{rig_id}.json", Rig)
        return self._rigs[rig_id]

    def in_rig_order(self, row: int, cameras: Collection[str]) -> list[str]:
        """Return the given cameras that are in the view, in the order of the rig."""
        rig = self.rig(row)
        order = [] if rig is None else [camera.name for camera in rig.cameras]
        listed = [*(name for name in order if name in cameras), *sorted(set(cameras) - set(order))]
        return [name for name in listed if self._cameras is None or name in self._cameras]

    def static_mask(self, row: int, camera: str) -> UInt8 | None:
        """Return the rig's mask (H, W) of a camera; None if there is no such mask.

        Raises:
            DatasetError: the file is missing or broken.
        """
        rig = self.rig(row)
        if rig is None:
            return None
        key = (rig.rig_id, camera)
        if key not in self._static_masks:
            names = [item.static_mask for item in rig.cameras if item.name == camera]
            path = names[0] if names else None
            found = None if path is None else self._grey(f"rigs/{path}", None, f"static mask of camera {camera}")
            self._static_masks[key] = found
        return self._static_masks[key]

    def mask(self, uri: str, byte_length: int, place: str) -> UInt8:
        """Read the pixels (H, W) of a mask.

        Raises:
            DatasetError: the file is missing or broken.
        """
        return self._grey(uri, byte_length, place)

    def depth(self, uri: str, byte_length: int, shape: tuple[int, int], place: str) -> Float32:
        """Read the depths (H, W) of a map in metres, NaN where unknown.

        Raises:
            DatasetError: the file is missing or broken, or has another shape.
        """
        from mirror.dataset.images.depth_codec import decode_depth

        depth = decode_depth(self.read(uri, 0, byte_length, place))
        if depth is None or depth.shape != shape:
            problem = "cannot be decoded" if depth is None else f"has {depth.shape[1]} x {depth.shape[0]} px"
            raise self._unreadable(uri, place, problem, f"a 16-bit grey PNG of {shape[1]} x {shape[0]} px")
        return depth

    def read(self, uri: str, offset: int, length: int, place: str) -> bytes:
        """Read ``length`` bytes of a file.

        Raises:
            DatasetError: the file is missing or too short.
        """
        return self.read_range(ByteRange(uri, offset, length), place)

    def read_range(self, one: ByteRange, place: str) -> bytes:
        """Read the bytes of a range.

        Raises:
            DatasetError: the file is missing or too short, or was changed.
        """
        uri, offset, length = one[:3]
        try:
            ahead = self.read_ahead.take(*one)
            data = one.read(self.store) if ahead is None else ahead
        except DatasetError as error:
            error.place = error.place or place
            raise
        except OSError as error:
            raise self._unreadable(uri, place, f"cannot be read: {error.strerror or error}") from error
        if len(data) != length:
            raise self._unreadable(uri, place, f"ends after {offset + len(data)} bytes", f"{offset + length} bytes")
        return data

    def has_intact_video(self, uri: str, offset: int, length: int, sha256: bytes, place: str) -> bool:
        """Return whether a video has the recorded hash. An intact video is read once, not for each of its frames.

        Raises:
            DatasetError: the file is missing or too short.
        """
        key = (uri, offset, length, sha256)
        if key not in self._intact_videos:
            if hashlib.sha256(self.read(uri, offset, length, place)).digest() != sha256:
                return False
            self._intact_videos.add(key)
        return True

    def video_frame(self, uri: str, pts: int, place: str) -> UInt8 | None:
        """Decode a frame of a video to pixels (H, W, 3); None if the frame is missing or the video is broken.

        Raises:
            DatasetError: the video cannot be opened.
        """
        try:
            return self._videos.decode(uri, pts)
        except OSError as error:
            raise self._unreadable(uri, place, f"cannot be opened: {error.strerror or error}") from error

    def _grey(self, uri: str, byte_length: int | None, place: str) -> UInt8:
        from mirror.dataset.images.decoding import decode_grey

        try:
            data = self.store.read(uri) if byte_length is None else self.read(uri, 0, byte_length, place)
        except OSError as error:
            raise self._unreadable(uri, place, f"cannot be read: {error.strerror or error}") from error
        pixels = decode_grey(data)
        if pixels is None:
            raise self._unreadable(uri, place, "cannot be decoded", "a complete PNG")
        return pixels

    def _unreadable(self, uri: str, place: str, problem: str, expected: str | None = None) -> DatasetError:
        return DatasetError(
            problem,
            file=self.store.full_path(uri),
            place=place,
            expected=expected or "a readable file",
            remedy=image_remedy(self.store, uri),
        )
