"""Frames: synchronised pictures of a rig with poses, intrinsics, boxes and masks, read when they are asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, overload

import numpy as np

from mirror.arrays import Float32, Int64, UInt8
from mirror.dataset.loader import Loader
from mirror.dataset.query.arrow import numbers
from mirror.dataset.query.select import Part, select
from mirror.dataset.traversal import Calibration, FrameBoxes, Traversal
from mirror.errors import DatasetError, UsageError
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses

if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset


@dataclass(frozen=True, eq=False)
class Mask:
    """One mask of one picture.

    Attributes:
        kind: what non-zero pixels are: dynamic, ego, sky or instance.
        source: who made it.
        source_version: version of the source.
        uri: its PNG.
        byte_length: its size.
    """

    kind: str
    source: str
    source_version: str
    uri: str
    byte_length: int
    _loader: Loader = field(repr=False)

    def decode(self) -> UInt8:
        """Pixels (H, W).

        Raises:
            DatasetError: the file is missing or broken.
        """
        return self._loader.mask(self.uri, self.byte_length, f"{self.kind} mask of {self.source}")


@dataclass(frozen=True, eq=False)
class DepthImage:
    """The depth map of one picture; its pose is the picture's.

    Attributes:
        lens: the pinhole that it is seen through, with the map's raster.
        source: who made it.
        source_version: version of the source.
        uri: its PNG.
        byte_length: its size.
    """

    lens: Camera
    source: str
    source_version: str
    uri: str
    byte_length: int
    _loader: Loader = field(repr=False)

    def decode(self) -> Float32:
        """The camera's z (H, W) in metres; NaN where unknown.

        Raises:
            DatasetError: the file is missing or broken, or of another size than its row says.
        """
        place = f"depth of {self.source}@{self.source_version}"
        return self._loader.depth(self.uri, self.byte_length, (self.lens.height_px, self.lens.width_px), place)


@dataclass(frozen=True, eq=False)
class Image:
    """One picture of one camera.

    Attributes:
        camera: the camera's name.
        timestamp_ns: mid-exposure: the instant of its pose.
        exposure_start_ns: start of the exposure of the first row.
        exposure_end_ns: end of the exposure of the last row.
        width_px: of the stored raster.
        height_px: of the stored raster.
        uri: where the bytes lie.
        byte_offset: first byte there.
        byte_length: number of bytes.
        codec: jpeg, png or video.
        video_pts: which frame of a video.
        sha256: of the bytes; None: not hashed at ingest.
        privacy: raw or redacted.
    """

    camera: str
    timestamp_ns: int
    exposure_start_ns: int
    exposure_end_ns: int
    width_px: int
    height_px: int
    uri: str
    byte_offset: int
    byte_length: int
    codec: str
    video_pts: int | None
    sha256: bytes | None
    privacy: str
    _traversal: Traversal = field(repr=False)
    _loader: Loader = field(repr=False)

    def read(self, *, verify: bool = False) -> bytes:
        """The encoded bytes; of a video frame, those of the whole video.

        Args:
            verify: hold them against ``sha256``.

        Raises:
            DatasetError: missing or cut short, or another hash; file, camera and timestamp are named.
        """
        data = self._loader.read(self.uri, self.byte_offset, self.byte_length, self._place)
        if verify and self.sha256 is not None and hashlib.sha256(data).digest() != self.sha256:
            raise self._broken("the bytes are not those that were recorded", f"SHA-256 {self.sha256.hex()}")
        return data

    def decode(self, *, verify: bool = False) -> UInt8:
        """Pixels (height, width, 3), RGB.

        Raises:
            DatasetError: missing, broken, or of another size than its row says; file, camera and timestamp are named.
        """
        from mirror.dataset.pictures.still import decode_rgb

        if self.video_pts is None:
            pixels = decode_rgb(self.read(verify=verify), self.codec)
        else:
            if verify:
                self.read(verify=True)
            pixels = self._loader.video_frame(self.uri, self.video_pts, self._place)
        if pixels is None:
            raise self._broken("the picture cannot be decoded", f"a complete {self.codec}")
        if pixels.shape[:2] != (self.height_px, self.width_px):
            height, width = pixels.shape[:2]
            raise self._broken(f"the picture is {width} x {height} px", f"{self.width_px} x {self.height_px} px")
        return pixels

    @property
    def calibration(self) -> Calibration:
        """The calibration that holds for this picture, of the chosen layer and stage.

        Raises:
            DatasetError: there is none.
        """
        return self._traversal.calibration(self.camera, self.timestamp_ns)

    @property
    def camera_model(self) -> Camera:
        """The intrinsics that hold for this picture."""
        return self.calibration.model

    @property
    def world_SE3_camera(self) -> Poses:  # noqa: N802
        """The camera's pose at mid-exposure, composed of the ego's and the mounting (one pose).

        Raises:
            DatasetError: the chosen poses do not cover it, or no calibration holds.
        """
        return self._traversal.world_SE3_ego(self.timestamp_ns) @ self.calibration.ego_SE3_camera

    def depth(self) -> DepthImage | None:
        """The depth map of this picture, of the chosen layer; None: it has none.

        Raises:
            UsageError: the traversal has several layers of depth maps and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        row = self._traversal.depth(self.camera, self.timestamp_ns)
        if row is None:
            return None
        lens = Camera(
            "pinhole", row["width_px"], row["height_px"], row["fx_px"], row["fy_px"], row["cx_px"], row["cy_px"]
        )
        return DepthImage(lens, row["source"], row["source_version"], row["uri"], row["byte_length"], self._loader)

    def masks(self) -> list[Mask]:
        """Masks of this picture, of all layers, by kind."""
        rows = self._traversal.masks(self.camera, self.timestamp_ns)
        return [
            Mask(row["kind"], row["source"], row["source_version"], row["uri"], row["byte_length"], self._loader)
            for row in rows
        ]

    def static_mask(self) -> UInt8 | None:
        """Pixels (H, W), non-zero where the vehicle itself is seen; None: not known.

        Raises:
            DatasetError: the rig names a mask that is missing or broken.
        """
        return self._loader.static_mask(self._traversal.row, self.camera)

    @property
    def _place(self) -> str:
        return f"camera {self.camera}, timestamp_ns {self.timestamp_ns}"

    def _broken(self, problem: str, expected: str) -> DatasetError:
        return DatasetError(
            problem,
            file=self._loader.store.where(self.uri),
            place=self._place,
            expected=expected,
            remedy="restore the file, or `mirror ingest RECORDING... --replace` from the recording",
        )


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant of a rig.

    Attributes:
        scene_id: the scene.
        traversal_id: the traversal.
        frame_index: counts from 0 within the traversal.
        timestamp_ns: mid-exposure of the reference camera.
    """

    scene_id: str
    traversal_id: str
    frame_index: int
    timestamp_ns: int
    _traversal: Traversal = field(repr=False)
    _loader: Loader = field(repr=False)

    @cached_property
    def images(self) -> Mapping[str, Image]:
        """Pictures by camera, in the rig's order; a camera without a picture in this frame is not there."""
        rows = {row["camera"]: row for row in self._traversal.pictures(self.frame_index)}
        return {
            camera: Image(**rows[camera], _traversal=self._traversal, _loader=self._loader)
            for camera in self._loader.rig_order(self._traversal.row, rows)
        }

    @property
    def world_SE3_ego(self) -> Poses:  # noqa: N802
        """The ego's pose at the frame's instant (one pose), of the chosen pose layer.

        Raises:
            DatasetError: the poses do not cover it.
        """
        return self._traversal.world_SE3_ego(self.timestamp_ns)

    @property
    def track(self) -> tuple[Int64, Poses]:
        """Stamps (N,) and ``world_SE3_ego`` of the whole traversal, as dense as the chosen pose layer has them."""
        return self._traversal.track

    @property
    def track_ids(self) -> tuple[str, ...]:
        """Every object that the boxes of the whole traversal have, of the chosen layer, sorted.

        Raises:
            UsageError: there are several box layers and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        return self._traversal.track_ids

    def boxes(self, frame: str = "ego") -> FrameBoxes:
        """The boxes nearest in time, at most half a period of theirs away.

        Args:
            frame: ``ego`` at the boxes' own instant, ``world``, or ``camera:<name>`` at that picture's mid-exposure.

        Raises:
            UsageError: no such frame, no picture of that camera, or several box layers and none chosen.
            DatasetError: the chosen poses or calibrations do not reach.
        """
        boxes = self._traversal.boxes(self.timestamp_ns)
        if frame == "ego":
            return boxes
        kind, _, camera = frame.partition(":")
        if not (frame == "world" or (kind == "camera" and camera in self.images)):
            known = ["ego", "world", *(f"camera:{name}" for name in self.images)]
            raise UsageError(f"unknown frame {frame!r}", expected=f"one of {', '.join(known)}")
        if not len(boxes):
            return boxes.into(frame, Poses.identity())
        world_SE3_ego = self._traversal.world_SE3_ego(boxes.timestamp_ns)
        if frame == "world":
            return boxes.into(frame, world_SE3_ego)
        return boxes.into(frame, self.images[camera].world_SE3_camera.inverse() @ world_SE3_ego)

    def decode(
        self, cameras: Sequence[str] | None = None, *, threads: int | None = None, verify: bool = False
    ) -> UInt8:
        """The pictures of several cameras as one contiguous array (C, 3, H, W), RGB.

        Args:
            cameras: which, in this order; default: all of `images`.
            threads: None: one a core; 1: none but the caller's, for loader processes.
            verify: hold the bytes against their hashes.

        Raises:
            UsageError: a camera has no picture in this frame, or the sizes differ.
            DatasetError: a picture is missing or broken.
        """
        images = self.images
        names = list(images) if cameras is None else list(cameras)
        for name in names:
            if name not in images:
                raise UsageError(f"no picture of camera {name!r} in {self._name}", expected=f"of {', '.join(images)}")
        sizes = {(images[name].height_px, images[name].width_px): name for name in names}
        if len(sizes) > 1:
            listed = ", ".join(f"{name} {width} x {height} px" for (height, width), name in sizes.items())
            raise UsageError(f"pictures of different sizes: {listed}", remedy="decode them one by one, or by size")
        planes = np.empty((len(names), 3, *next(iter(sizes), (0, 0))), np.uint8)
        self.decode_into(planes, names, threads=threads, verify=verify)
        return planes

    def decode_into(
        self, planes: UInt8, cameras: Sequence[str], *, threads: int | None = None, verify: bool = False
    ) -> None:
        """Decode into an array that is there already; that of a camera without a picture is left as it is.

        Args:
            planes: (C, 3, H, W), each camera's part contiguous.
            cameras: (C,) names.
            threads: as for `decode`.
            verify: as for `decode`.

        Raises:
            UsageError: a picture is not of the size (H, W).
            DatasetError: a picture is missing or broken.
        """
        wanted = [(self.images[name], out) for name, out in zip(cameras, planes) if name in self.images]
        for image, out in wanted:
            if out.shape != (3, image.height_px, image.width_px):
                raise UsageError(
                    f"camera {image.camera} of {self._name} has {image.width_px} x {image.height_px} px",
                    expected=f"{out.shape[2]} x {out.shape[1]} px",
                )
        self._loader.decode_into(wanted, threads=threads, verify=verify)

    @property
    def _name(self) -> str:
        return f"frame {self.frame_index} of {self.traversal_id}"


@dataclass(frozen=True, eq=False, repr=False)
class FrameSequence(Sequence[Frame]):
    """Frames of a view, in order of traversal and time; nothing of them is held but what finds them.

    Attributes:
        parts: row groups of the frames table, with the rows that are in the view.
        starts: (len(parts) + 1,) position of each part's first frame.
        chosen: positions that a slice has left.
    """

    parts: Sequence[Part]
    starts: Int64
    chosen: range
    _loader: Loader

    @classmethod
    def of(cls, dataset: Dataset) -> FrameSequence:
        """All frames of a view."""
        parts = list(select(dataset.catalog, dataset.filters, "frames"))
        starts = np.cumsum([0, *(part.rows for part in parts)], dtype=np.int64)
        loader = Loader(dataset.catalog, dataset.layers, dataset.filters.camera)
        return cls(parts, starts, range(int(starts[-1])), loader)

    def __len__(self) -> int:
        return len(self.chosen)

    def __repr__(self) -> str:
        return f"FrameSequence({len(self)} frames of {len(self.parts)} traversals)"

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> FrameSequence: ...
    def __getitem__(self, index: int | slice) -> Frame | FrameSequence:
        """One frame, or a sequence of some."""
        if isinstance(index, slice):
            return FrameSequence(self.parts, self.starts, self.chosen[index], self._loader)
        position = self.chosen[index]
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
            frame_index=int(numbers(columns[0])[row]),
            timestamp_ns=int(numbers(columns[1])[row]),
            _traversal=traversal,
            _loader=self._loader,
        )

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))
