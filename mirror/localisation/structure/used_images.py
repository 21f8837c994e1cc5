"""The images of a camera that are used, those between which the image moves; their features, without road users."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float32, Int64, UInt8
from mirror.calibration.refinement.features import ImageFeatures, find_features
from mirror.calibration.tracking import TrackedImage
from mirror.errors import RecordingError
from mirror.geometry import Poses
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.cameras import Camera
from mirror.recordings.protocol import CameraInfo, ImageStream, Recording

_SMALL_PX: Final = 480
_CORNERS: Final = 400
_LEAST_TRACKED: Final = 30
_NEAREST_BOX_NS: Final = 60_000_000
_PARKED_MPS: Final = 0.3


@dataclass(frozen=True, eq=False)
class UsedImages:
    """The used images of one camera.

    Attributes:
        camera: the camera's name.
        index: (N,) ascending places in the camera's stream.
        time_ns: (N,) middles of the exposures.
        features: N sets of features.
        width_px: width of the images.
        height_px: height of the images.
        total: number of images of the stream.
    """

    camera: str
    index: Int64
    time_ns: Int64
    features: Sequence[ImageFeatures]
    width_px: int
    height_px: int
    total: int

    def __len__(self) -> int:
        return len(self.index)


def mid_exposure_ns(stream: ImageStream) -> Int64:
    """Return the middles (N,) of the exposures of a stream."""
    return stream.exposure_start_ns + (stream.exposure_end_ns - stream.exposure_start_ns) // 2


def read_grey(data: bytes, place: str) -> UInt8:
    """Decode an image to grey; the raster is the camera's, whatever the orientation in EXIF data.

    Raises:
        RecordingError: it cannot be decoded.
    """
    import cv2

    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    if image is None:
        raise RecordingError("the image cannot be decoded", place=place, expected="JPEG or PNG")
    return np.asarray(image, np.uint8)


class StaticPixels:
    """The pixels of a camera's images that show neither the vehicle itself nor a road user that may move.

    Args:
        recording: its static mask and its boxes that move, or have an unknown speed, are hidden.
        camera: the camera.
        lens: its lens and mounting, to project the boxes; None: boxes cannot be projected.
        masks: folder of masks, ``CAMERA/TIMESTAMP_NS.png``, non-zero on road users; None: there are none.
    """

    def __init__(
        self, recording: Recording, camera: CameraInfo, lens: tuple[Camera, Poses] | None, masks: Path | None
    ) -> None:
        self.camera, self.lens, self.folder = camera, lens, None if masks is None else masks / camera.name
        if self.folder is not None and not self.folder.is_dir():
            raise RecordingError(
                "there is no folder of masks of the camera", file=self.folder, place="--masks",
                expected="CAMERA/TIMESTAMP_NS.png, non-zero on road users",
            )  # fmt: skip
        table = None if lens is None else recording.boxes()
        self.boxes = None
        if table is not None and len(table):
            size = np.column_stack([table[name].to_numpy() for name in ("length_m", "width_m", "height_m")])
            speed = np.column_stack([table[f"v{axis}_mps"].to_numpy() for axis in "xyz"]).astype(np.float64)
            moving = ~(np.linalg.norm(speed, axis=1) < _PARKED_MPS)
            stamp = table["timestamp_ns"].to_numpy()
            names = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
            poses = Poses.from_columns({name: table[name].to_numpy() for name in names})
            self.boxes = stamp[moving], poses[moving], size[moving]
        self.hidden = 0

    def mark_static(self, time_ns: int, shape: tuple[int, ...]) -> Bool:
        """Mark the static pixels (H, W) of the image that was taken at a time.

        Raises:
            RecordingError: a mask has another size than its image.
        """
        import cv2

        still = np.ones(shape, np.bool_)
        if self.camera.static_mask is not None:
            still &= self._fitting(self.camera.static_mask, shape, "static mask") == 0
        if self.folder is not None and (file := self.folder / f"{time_ns}.png").is_file():
            found = cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
            if found is None:
                raise RecordingError("the mask cannot be decoded", file=file, expected="a PNG")
            still &= self._fitting(np.asarray(found, np.uint8), shape, str(file)) == 0
            self.hidden += 1
        if self.boxes is not None and self.lens is not None:
            stamp, poses, size = self.boxes
            near = np.abs(stamp - time_ns)
            own = np.flatnonzero((near == near.min()) & (near <= _NEAREST_BOX_NS)) if len(stamp) else np.empty(0, int)
            if len(own):
                camera, mounting = self.lens
                bounds = project_boxes(camera, mounting.inverse() @ poses[own], size[own]).bounds_px
                for left, top, right, bottom in bounds[np.isfinite(bounds).all(axis=1)]:
                    still[int(top) : int(np.ceil(bottom)) + 1, int(left) : int(np.ceil(right)) + 1] = False
                self.hidden += 1
        return still

    def _fitting(self, mask: UInt8, shape: tuple[int, ...], place: str) -> UInt8:
        if mask.shape != shape:
            raise RecordingError(
                f"the mask has {mask.shape[1]} x {mask.shape[0]} px, the image {shape[1]} x {shape[0]}",
                place=f"camera {self.camera.name}, {place}", expected="the size of the image",
            )  # fmt: skip
        return mask


class _Motion:
    """The motion of the image since the last image that was used."""

    def __init__(self) -> None:
        self.last: UInt8 | None = None
        self.corners: Float32 | None = None

    def percent(self, small: UInt8) -> float:
        """Return the median motion since the used image, percent of the width; infinite where it cannot be followed."""
        import cv2

        if self.last is None or self.corners is None or len(self.corners) < _LEAST_TRACKED:
            return np.inf
        moved, status, _ = cv2.calcOpticalFlowPyrLK(self.last, small, self.corners, None, winSize=(15, 15), maxLevel=4)  # type: ignore[call-overload]
        found = status.ravel() > 0
        if np.count_nonzero(found) < _LEAST_TRACKED:
            return np.inf
        way = np.linalg.norm((moved - self.corners).reshape(-1, 2)[found], axis=1)
        return float(100.0 * np.median(way) / small.shape[1])

    def use(self, small: UInt8) -> None:
        """Measure from this image on."""
        import cv2

        corners = cv2.goodFeaturesToTrack(small, _CORNERS, 0.01, 7)
        self.last = small
        self.corners = None if corners is None else np.asarray(corners, np.float32)


def choose_images(
    stream: ImageStream,
    still: StaticPixels,
    motion_percent: float,
    longest_step_s: float,
    features: int,
    advance: Callable[[int], None],
) -> UsedImages:
    """Read the images of a camera, choose those between which the image moves, and find their features.

    Args:
        stream: the images.
        still: the pixels to use.
        motion_percent: median motion after which the next image is used, percent of the width.
        longest_step_s: an image is used after this time even if nothing moves.
        features: largest number of features of an image.
        advance: is called with 1 after each image.

    Raises:
        RecordingError: an image cannot be decoded, or the images have several sizes.
    """
    import cv2

    time_ns = mid_exposure_ns(stream)
    motion, chosen, found = _Motion(), list[int](), list[ImageFeatures]()
    shape: tuple[int, ...] | None = None
    for index, data in stream.read(range(len(time_ns))):
        place = f"camera {stream.camera}, image {index}"
        grey = read_grey(data, place)
        if shape is not None and grey.shape != shape:
            raise RecordingError(
                f"{grey.shape[1]} x {grey.shape[0]} px, but the images before have {shape[1]} x {shape[0]}",
                place=place, expected="images of one size",
            )  # fmt: skip
        shape = grey.shape
        size = (_SMALL_PX, max(1, round(_SMALL_PX * shape[0] / shape[1])))
        small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
        late = bool(chosen) and time_ns[index] - time_ns[chosen[-1]] >= longest_step_s * 1e9
        if late or motion.percent(small) >= motion_percent:
            motion.use(small)
            chosen.append(index)
            found.append(
                find_features(TrackedImage.from_grey(grey, still.mark_static(int(time_ns[index]), shape)), features)
            )
        advance(1)
    if shape is None:
        raise RecordingError("no images", place=f"camera {stream.camera}", expected="images of a moving vehicle")
    index_of = np.array(chosen, np.int64)
    return UsedImages(stream.camera, index_of, time_ns[index_of], found, shape[1], shape[0], len(time_ns))
