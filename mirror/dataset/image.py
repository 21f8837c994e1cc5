"""One image of one camera, with its pose, intrinsics, masks and depth, read when they are asked for."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

from mirror.arrays import Float32, UInt8
from mirror.dataset.loader import Loader
from mirror.dataset.traversal import Calibration, Traversal
from mirror.errors import DatasetError
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses


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
        """Decode the pixels (height, width, 3), uint8, RGB.

        Args:
            verify: compare the bytes with ``sha256`` first.

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
        """The camera's pose at mid-exposure (one pose): the ego pose composed with the camera's mounting.

        Raises:
            DatasetError: the chosen poses do not cover the image's time, or no calibration is valid then.

        Example:
            >>> image = mirror.open("dataset").frames()[0].images["rear"]
            >>> image.world_SE3_camera.translation.shape
            (1, 3)
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
            file=self._loader.store.full_path(self.uri),
            place=self._place,
            expected=expected,
            remedy="restore the file, or `mirror ingest RECORDING... --replace` from the recording",
        )
