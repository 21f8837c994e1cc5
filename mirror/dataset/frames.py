"""Frames: synchronised images of a rig with poses, intrinsics, boxes and masks. They are read on first use."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import overload

import numpy as np

from mirror.arrays import Int64, UInt8
from mirror.dataset.image import Image
from mirror.dataset.layers import LayerChoice
from mirror.dataset.lidars import LidarFiles
from mirror.dataset.loader import Loader
from mirror.dataset.query.arrow import to_numpy
from mirror.dataset.query.catalog import Catalog
from mirror.dataset.query.filters import Filters
from mirror.dataset.query.select import RowGroupPart, select_parts
from mirror.dataset.read_ahead import ByteRange
from mirror.dataset.traversal import CameraCalibration, FrameBoxes, Traversal
from mirror.errors import UsageError
from mirror.geometry.poses import Poses


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant of a rig: an exposure of the reference camera and the nearest image of each other camera.

    Attributes:
        scene_id: the scene.
        traversal_id: the traversal.
        frame_index: number of the frame in its traversal, from 0.
        timestamp_ns: mid-exposure of the reference camera, Unix.
    """

    scene_id: str
    traversal_id: str
    frame_index: int
    timestamp_ns: int
    _traversal: Traversal = field(repr=False)
    _loader: Loader = field(repr=False)

    @cached_property
    def images(self) -> Mapping[str, Image]:
        """Images by camera, in the rig's order; cameras without an image in this frame are left out."""
        rows = {row["camera"]: row for row in self._traversal.image_rows(self.frame_index)}
        return {
            camera: Image(**rows[camera], _traversal=self._traversal, _loader=self._loader)
            for camera in self._loader.in_rig_order(self._traversal.row, rows)
        }

    @property
    def world_SE3_ego(self) -> Poses:  # noqa: N802
        """The ego pose at the frame's time (one pose), of the chosen pose layer.

        Raises:
            DatasetError: the poses do not cover that time.
        """
        return self._traversal.world_SE3_ego(self.timestamp_ns)

    @property
    def track(self) -> tuple[Int64, Poses]:
        """Timestamps (N,) and N poses ``world_SE3_ego`` of the whole traversal, of the chosen pose layer."""
        return self._traversal.track

    @property
    def calibrations(self) -> Sequence[CameraCalibration]:
        """All calibrations of the whole traversal, of the chosen layer: of every camera, stage and interval."""
        return self._traversal.calibrations

    @property
    def lidars(self) -> tuple[LidarFiles, ...]:
        """All lidar sweeps of the whole traversal, by sensor and format: files of the source, which were never opened.

        Raises:
            DatasetError: their table is missing.
        """
        return self._traversal.lidars

    @property
    def track_ids(self) -> tuple[str, ...]:
        """Ids of all objects in the traversal's chosen box layer, sorted.

        Raises:
            UsageError: the traversal has several box layers and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        return self._traversal.track_ids

    def boxes(self, frame: str = "ego") -> FrameBoxes:
        """Return the boxes of the nearest time, if within half the boxes' period; else no boxes.

        Args:
            frame: frame of the poses: ``ego`` at the boxes' own time, ``world``, or ``camera:<name>`` at the
                mid-exposure of that camera's image.

        Raises:
            UsageError: the frame is unknown, the camera has no image, or there are several box layers and none was
                chosen.
            DatasetError: the chosen poses or calibrations do not cover the time.

        Example:
            >>> frame = mirror.open("dataset").frames()[0]
            >>> boxes = frame.boxes("camera:front_wide")
            >>> boxes.category, boxes.size_m.shape
            (('van', 'car'), (2, 3))
        """
        boxes = self._traversal.boxes(self.timestamp_ns)
        if frame == "ego":
            return boxes
        kind, _, camera = frame.partition(":")
        if not (frame == "world" or (kind == "camera" and camera in self.images)):
            known = ["ego", "world", *(f"camera:{name}" for name in self.images)]
            raise UsageError(f"unknown frame {frame!r}", expected=f"one of {', '.join(known)}")
        if not len(boxes):
            return boxes.to_frame(frame, Poses.identity())
        world_SE3_ego = self._traversal.world_SE3_ego(boxes.timestamp_ns)
        if frame == "world":
            return boxes.to_frame(frame, world_SE3_ego)
        return boxes.to_frame(frame, self.images[camera].world_SE3_camera.inverse() @ world_SE3_ego)

    def decode(
        self, cameras: Sequence[str] | None = None, *, threads: int | None = None, verify: bool = False
    ) -> UInt8:
        """Decode the images of several cameras into one contiguous array (C, 3, H, W), uint8, RGB.

        Args:
            cameras: the cameras, in this order; default: all of `images`.
            threads: number of threads; None: one a core; 1: only the calling thread, for worker processes.
            verify: compare the bytes with their hashes.

        Raises:
            UsageError: a camera has no image in this frame, or the sizes differ.
            DatasetError: an image is missing or broken.

        Example:
            >>> frame = mirror.open("dataset").frames()[0]
            >>> frame.decode(["front_wide", "rear"]).shape
            (2, 3, 64, 96)
        """
        images = self.images
        names = list(images) if cameras is None else list(cameras)
        for name in names:
            if name not in images:
                raise UsageError(f"no image of camera {name!r} in {self._name}", expected=f"of {', '.join(images)}")
        sizes = {(images[name].height_px, images[name].width_px): name for name in names}
        if len(sizes) > 1:
            listed = ", ".join(f"{name} {width} x {height} px" for (height, width), name in sizes.items())
            raise UsageError(
                f"images of different sizes: {listed}", remedy="decode them one by one, or grouped by size"
            )
        planes = np.empty((len(names), 3, *next(iter(sizes), (0, 0))), np.uint8)
        self.decode_into(planes, names, threads=threads, verify=verify)
        return planes

    def decode_into(
        self, planes: UInt8, cameras: Sequence[str], *, threads: int | None = None, verify: bool = False
    ) -> None:
        """Decode images into an existing array; the part of a camera without an image is not changed.

        Args:
            planes: (C, 3, H, W) uint8; the part of each camera is contiguous.
            cameras: C names.
            threads: as in `decode`.
            verify: as in `decode`.

        Raises:
            UsageError: an image does not have the size (H, W).
            DatasetError: an image is missing or broken.
        """
        jobs = [(self.images[name], out) for name, out in zip(cameras, planes) if name in self.images]
        for image, out in jobs:
            if out.shape != (3, image.height_px, image.width_px):
                raise UsageError(
                    f"camera {image.camera} of {self._name} has {image.width_px} x {image.height_px} px",
                    expected=f"{out.shape[2]} x {out.shape[1]} px",
                )
        ranges = [image.byte_range for image, _ in jobs]
        with self._loader.read_ahead.reading([] if any(image.video_pts is not None for image, _ in jobs) else ranges):
            _decode_into(jobs, threads=threads, verify=verify)

    def _repr_html_(self) -> str:
        """Return the frame as HTML for notebooks: a thumbnail of each image and a table."""
        from mirror.dataset.notebook import show_frame

        try:
            boxes = self.boxes()
            words = f"{len(boxes)}: {', '.join(sorted(set(boxes.category)))}" if len(boxes) else "none"
        except UsageError as error:
            # Of several layers none is chosen.
            words = error.problem
        place = {"scene": self.scene_id, "traversal": self.traversal_id, "frame": self.frame_index}
        return show_frame(place, self.timestamp_ns, self.images, words)

    @property
    def _name(self) -> str:
        return f"frame {self.frame_index} of {self.traversal_id}"


@dataclass(frozen=True, eq=False, repr=False)
class FrameSequence(Sequence[Frame]):
    """The frames of a view, by traversal and time; only their positions in the index are held.

    Attributes:
        parts: row groups of the frames table, with their rows in the view.
        starts: (len(parts) + 1,) position of each part's first frame.
        positions: positions of the frames of this sequence; a slice keeps some of them.
    """

    parts: Sequence[RowGroupPart]
    starts: Int64
    positions: range
    _loader: Loader

    @classmethod
    def from_view(cls, catalog: Catalog, filters: Filters, layers: LayerChoice) -> FrameSequence:
        """Select all frames that pass the filters."""
        parts = list(select_parts(catalog, filters, "frames"))
        starts = np.cumsum([0, *(part.rows for part in parts)], dtype=np.int64)
        loader = Loader(catalog, layers, filters.camera)
        return cls(parts, starts, range(int(starts[-1])), loader)

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return f"FrameSequence({len(self)} frames of {len(self.parts)} traversals)"

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> FrameSequence: ...
    def __getitem__(self, index: int | slice) -> Frame | FrameSequence:
        """One frame, or the frames of a slice."""
        if isinstance(index, slice):
            return FrameSequence(self.parts, self.starts, self.positions[index], self._loader)
        position = self.positions[index]
        number = int(np.searchsorted(self.starts, position, side="right")) - 1
        part = self.parts[number]
        row = position - int(self.starts[number])
        if part.mask is not None:
            row = int(np.flatnonzero(part.mask)[row])
        columns = self._loader.catalog.columns.read(part.path, part.number, ["frame_index", "timestamp_ns"])
        scene_id, traversal = self._loader.traversal(part.traversal)
        return Frame(
            scene_id=scene_id,
            traversal_id=traversal.traversal_id,
            frame_index=int(to_numpy(columns[0])[row]),
            timestamp_ns=int(to_numpy(columns[1])[row]),
            _traversal=traversal,
            _loader=self._loader,
        )

    def __iter__(self) -> Iterator[Frame]:
        """The frames in order; images of the next ones are being read where they lie far away."""
        for (frame,) in self.read_ahead([index] for index in range(len(self))):
            yield frame

    def read_ahead(
        self, groups: Iterable[Sequence[int]], cameras: Sequence[str] | None = None, *, masks: bool = False
    ) -> Iterator[list[Frame]]:
        """Yield the frames of groups of indices, such as batches, while the images of the next ones are being read.

        Only images that are not on a disk of this machine are read ahead: those side by side in one request, and up to
        `mirror.dataset.read_ahead.WINDOW_BYTES` of them. The order and the images do not depend on it.

        Args:
            groups: indices of frames.
            cameras: cameras whose images are needed; None: all of the view.
            masks: read the masks of the images too.

        Example:
            >>> frames = mirror.open("dataset").frames()
            >>> [[frame.frame_index for frame in batch] for batch in frames.read_ahead([[2, 0], [1]])]
            [[2, 0], [1]]
        """
        ahead = self._loader.read_ahead

        def find_ranges(frames: list[Frame]) -> list[ByteRange]:
            found = []
            for frame in frames:
                for camera, image in frame.images.items():
                    if (cameras is not None and camera not in cameras) or image.is_withheld:
                        continue
                    if image.video_pts is None:
                        found.append(image.byte_range)
                    if masks:
                        found += [ByteRange(mask.uri, 0, mask.byte_length) for mask in image.masks()]
            return [one for one in found if ahead.is_far(one.uri)]

        made = ([self[index] for index in group] for group in groups)
        if self._loader.store.folder is not None and not self._has_far_images:
            yield from made
            return
        yield from ahead.over(made, find_ranges)

    @cached_property
    def _has_far_images(self) -> bool:
        """Return whether the first image is not in the dataset."""
        loader = self._loader
        group = loader.catalog.group_of("images", self.parts[0].traversal) if self.parts else None
        if group is None:
            return False
        (uris,) = loader.catalog.columns.read(*group, ["uri"])
        return any(loader.read_ahead.is_far(uri) for uri in uris[:1].to_pylist())


def _decode_into(images: Sequence[tuple[Image, UInt8]], *, threads: int | None, verify: bool) -> None:
    """Decode images, each into its contiguous planes (3, H, W), on several threads."""
    from mirror.dataset.images.decoding import run_jobs, split_planes

    def decode_one(image: Image, planes: UInt8) -> None:
        split_planes(image.decode(verify=verify), planes)

    run_jobs([partial(decode_one, *image) for image in images], [image.byte_length for image, _ in images], threads)
