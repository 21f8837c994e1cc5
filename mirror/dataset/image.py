"""One image of one camera, with its pose, intrinsics, masks and depth. They are read on first use."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float32, Float64, UInt8
from mirror.dataset.loader import Loader
from mirror.dataset.read_ahead import ByteRange
from mirror.dataset.traversal import CameraCalibration, Traversal
from mirror.errors import DatasetError
from mirror.geometry.cameras import Camera
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.geometry.rolling_shutter import RollingShutter, project_rolling

_BEYOND_NS: Final = 200_000_000


@dataclass(frozen=True, eq=False)
class Mask:
    """One mask of one image.

    Attributes:
        kind: what its non-zero pixels show: dynamic, ego, sky or instance; redaction: pixels that were replaced.
        source: program that made it.
        source_version: version of the source.
        uri: the PNG file.
        byte_length: size of the file.
    """

    kind: str
    source: str
    source_version: str
    uri: str
    byte_length: int
    _loader: Loader = field(repr=False)

    def decode(self) -> UInt8:
        """Decode the pixels (H, W), uint8.

        Raises:
            DatasetError: the file is missing or broken.
        """
        return self._loader.mask(self.uri, self.byte_length, f"{self.kind} mask of {self.source}")


@dataclass(frozen=True, eq=False)
class DepthImage:
    """The depth map of one image, with the image's pose.

    Attributes:
        lens: its pinhole camera, with the raster of the map.
        source: program that made it.
        source_version: version of the source.
        uri: the PNG file.
        byte_length: size of the file.
    """

    lens: Camera
    source: str
    source_version: str
    uri: str
    byte_length: int
    _loader: Loader = field(repr=False)

    def decode(self) -> Float32:
        """Decode the depth (H, W) along the camera's z axis in metres, float32; NaN where unknown.

        Raises:
            DatasetError: the file is missing or broken, or its size is not the one in its row.
        """
        place = f"depth of {self.source}@{self.source_version}"
        return self._loader.depth(self.uri, self.byte_length, (self.lens.height_px, self.lens.width_px), place)


@dataclass(frozen=True, eq=False)
class Image:
    """One image of one camera.

    Attributes:
        camera: the camera's name.
        timestamp_ns: mid-exposure, Unix; the pose holds at this time.
        exposure_start_ns: start of the exposure of the first row.
        exposure_end_ns: end of the exposure of the last row.
        width_px: width of the stored raster.
        height_px: height of the stored raster.
        uri: file that holds the bytes.
        byte_offset: first byte in the file.
        byte_length: number of bytes.
        codec: jpeg, png or video.
        video_pts: presentation time stamp of the frame in a video; None: not a video.
        sha256: hash of the bytes; None: not hashed at ingest.
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
        """Read the encoded bytes; for a frame of a video, the bytes of the whole video.

        Args:
            verify: compare the bytes with ``sha256``.

        Raises:
            DatasetError: the file is missing or too short, or the hash differs; or an image outside of the dataset was
                changed, by its size or its ETag. The error names file, camera and timestamp.
        """
        data = self._loader.read_range(self.byte_range, self._place)
        if verify and self.sha256 is not None and hashlib.sha256(data).digest() != self.sha256:
            raise self._altered(self.sha256)
        return data

    def decode(self, *, verify: bool = False) -> UInt8:
        """Decode the pixels (height, width, 3), uint8, RGB.

        Args:
            verify: compare the bytes with ``sha256`` first; those of a video once for all frames of the sequence.

        Raises:
            DatasetError: the image is missing or broken, or its size is not the one in its row; the error names file,
                camera and timestamp.

        Example:
            >>> image = mirror.open("dataset").frames()[0].images["rear"]
            >>> image.decode().shape
            (64, 96, 3)
        """
        from mirror.dataset.images.decoding import decode_rgb

        if self.video_pts is None:
            pixels = decode_rgb(self.read(verify=verify), self.codec)
        else:
            if verify and self.sha256 is not None:
                source = self.uri, self.byte_offset, self.byte_length, self.sha256
                if not self._loader.has_intact_video(*source, self._place):
                    raise self._altered(self.sha256)
            pixels = self._loader.video_frame(self.uri, self.video_pts, self._place)
        if pixels is None:
            raise self._broken("the image cannot be decoded", f"a complete {self.codec}")
        if pixels.shape[:2] != (self.height_px, self.width_px):
            height, width = pixels.shape[:2]
            raise self._broken(f"the image is {width} x {height} px", f"{self.width_px} x {self.height_px} px")
        return pixels

    @property
    def byte_range(self) -> ByteRange:
        """The bytes of this image; an image outside of the dataset is a file of its own."""
        is_whole = "://" in self.uri and self.byte_offset == 0 and self.video_pts is None
        etag = self._traversal.etags.get(self.uri) if is_whole and self.sha256 is None else None
        return ByteRange(self.uri, self.byte_offset, self.byte_length, is_whole, etag)

    @property
    def is_withheld(self) -> bool:
        """Return whether the dataset is published and withholds this image, which only the organiser can read."""
        return self.uri in self._loader.catalog.withheld

    @property
    def calibration(self) -> CameraCalibration:
        """The calibration of the chosen layer and stage that is valid for this image.

        Raises:
            DatasetError: no calibration is valid.
        """
        return self._traversal.calibration(self.camera, self.timestamp_ns)

    @property
    def camera_model(self) -> Camera:
        """The intrinsics of this image's calibration."""
        return self.calibration.model

    @property
    def world_SE3_camera(self) -> Poses:  # noqa: N802
        """The camera's pose at mid-exposure (one pose): the ego pose composed with the camera's mounting.

        Raises:
            DatasetError: the chosen poses do not cover the image's time, or no calibration is valid then.

        Example:
            >>> image = mirror.open("dataset").frames()[0].images["rear"]
            >>> image.world_SE3_camera.translation.shape
            (1, 3)
        """
        return self._traversal.world_SE3_ego(self.timestamp_ns) @ self.calibration.ego_SE3_camera

    @property
    def shutter(self) -> RollingShutter:
        """The shutter of this image's calibration.

        Raises:
            DatasetError: no calibration is valid.
            UsageError: the calibration states a direction that the raster does not have.
        """
        row, camera = self.calibration.row, self.camera_model
        return RollingShutter(row["shutter_direction"], row["readout_ns"], camera.width_px, camera.height_px)

    def world_SE3_camera_at(self, offsets_ns: npt.ArrayLike) -> Poses:  # noqa: N802
        """Return the camera's poses at offsets (N,) from mid-exposure, such as the times of its rows, ns.

        Up to 0.2 s before the first and after the last pose the vehicle keeps its velocity: the first rows of an image
        may be exposed before the first pose.

        Raises:
            DatasetError: the chosen poses do not cover a time, or no calibration is valid.
        """
        stamps = self.timestamp_ns + np.round(np.atleast_1d(offsets_ns)).astype(np.int64)
        track, poses = self._traversal.track
        reaches = len(track) > 1 and stamps.min() >= track[0] - _BEYOND_NS and stamps.max() <= track[-1] + _BEYOND_NS
        egos = interpolate(track, poses, stamps, extrapolate=True) if reaches else self._traversal.world_SE3_ego(stamps)
        return egos @ self.calibration.ego_SE3_camera

    def project_moving(self, world_points_m: npt.ArrayLike, world_velocity_mps: npt.ArrayLike) -> Float64:
        """Project moving points, each at the time of the row or column that sees it.

        Args:
            world_points_m: (N, 3) points at mid-exposure.
            world_velocity_mps: (N, 3) or (3,) velocities; NaN counts as 0.

        Returns:
            (N, 2) pixels; NaN where the camera does not image a point.

        Raises:
            DatasetError: the chosen poses do not cover the readout, or no calibration is valid.
        """
        points = np.asarray(world_points_m, np.float64)
        velocity = np.nan_to_num(np.asarray(world_velocity_mps, np.float64))

        def points_at(offsets_ns: Float64) -> Float64:
            moved = points + 1e-9 * offsets_ns[:, None] * velocity
            cameras = self.world_SE3_camera_at(offsets_ns)
            return np.asarray(cameras.inverse().transform(moved[:, None])[:, 0])

        return project_rolling(self.camera_model, self.shutter, len(points), points_at)[0]

    def depth(self) -> DepthImage | None:
        """Return the depth map of this image in the chosen layer; None if there is no such map.

        Raises:
            UsageError: the traversal has several depth layers and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        row = self._traversal.depth_row(self.camera, self.timestamp_ns)
        if row is None:
            return None
        lens = Camera(
            "pinhole", row["width_px"], row["height_px"], row["fx_px"], row["fy_px"], row["cx_px"], row["cy_px"]
        )
        return DepthImage(lens, row["source"], row["source_version"], row["uri"], row["byte_length"], self._loader)

    def masks(self) -> list[Mask]:
        """Return the masks of this image in all layers, ordered by kind."""
        rows = self._traversal.mask_rows(self.camera, self.timestamp_ns)
        return [
            Mask(row["kind"], row["source"], row["source_version"], row["uri"], row["byte_length"], self._loader)
            for row in rows
        ]

    def static_mask(self) -> UInt8 | None:
        """Return the pixels (H, W), not zero where the recording vehicle is visible; None if the rig has no such mask.

        Raises:
            DatasetError: the rig names a mask that is missing or broken.
        """
        return self._loader.static_mask(self._traversal.row, self.camera)

    @property
    def _place(self) -> str:
        return f"camera {self.camera}, timestamp_ns {self.timestamp_ns}"

    def _altered(self, sha256: bytes) -> DatasetError:
        return self._broken("the bytes differ from the recorded ones", f"SHA-256 {sha256.hex()}")

    def _broken(self, problem: str, expected: str) -> DatasetError:
        return DatasetError(
            problem,
            file=self._loader.store.full_path(self.uri),
            place=self._place,
            expected=expected,
            remedy="restore the file, or `mirror ingest RECORDING... --replace` from the recording",
        )


def compose_camera_poses(images: Sequence[Image]) -> Poses:
    """Return the poses (M,) of M images of one traversal, each as its `Image.world_SE3_camera`.

    Raises:
        DatasetError: the chosen poses do not cover a time, or no calibration is valid.
    """
    mountings = [image.calibration.ego_SE3_camera for image in images]
    if not images:
        return Poses(np.zeros((0, 4)), np.zeros((0, 3)))
    egos = images[0]._traversal.world_SE3_ego([image.timestamp_ns for image in images])
    rotation = np.concatenate([pose.rotation for pose in mountings])
    return egos @ Poses.unchecked(rotation, np.concatenate([pose.translation for pose in mountings]))
