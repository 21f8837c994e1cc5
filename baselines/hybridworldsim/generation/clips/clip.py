"""One clip: consecutive frames of a rig, their backgrounds, and the road users in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hybridworldsim.generation.clips.map_lines import LINE_KINDS, MapLine
from mirror.arrays import AnyArray, Bool, Float64, Int64, UInt8
from mirror.errors import DatasetError

CATEGORIES: Final = ("car", "van", "truck", "bus", "motorcycle", "cyclist", "pedestrian")
"""Classes of boxes; `ClipBoxes.category` counts in this order."""

ABSENT: Final = -1
"""No road user, in the masks of a clip."""


@dataclass(frozen=True, eq=False)
class ClipBoxes:
    """The boxes of all frames of a clip.

    Attributes:
        frame: (N,) number of the frame.
        track: (N,) number of the road user.
        category: (N,) number of its class in `CATEGORIES`.
        ego_SE3_box: (N, 4, 4) pose in the ego frame of the frame's instant.
        lwh_m: (N, 3) length, width, height.
    """

    frame: Int64
    track: Int64
    category: Int64
    ego_SE3_box: Float64
    lwh_m: Float64

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: AnyArray | slice) -> ClipBoxes:
        return ClipBoxes(
            self.frame[rows], self.track[rows], self.category[rows], self.ego_SE3_box[rows], self.lwh_m[rows]
        )

    def at(self, frame: int) -> ClipBoxes:
        """Return the boxes of one frame."""
        return self[self.frame == frame]


@dataclass(frozen=True, eq=False)
class Clip:
    """F frames of V views of pinhole cameras.

    Attributes:
        clip_id: id of the clip.
        drive_id: id of the drive that it is a part of; intervals are bootstrapped over drives.
        rate_hz: frames per second.
        views: (V) names of the cameras.
        images: (F, V, H, W, 3) colours, red first.
        background: (F, V, H, W, 3) the same views of the static street without road users.
        present: (F, V) which images exist.
        intrinsics: (V, 3, 3) pixels; the centre of the first pixel is at (0.5, 0.5).
        ego_SE3_camera: (V, 4, 4).
        start_SE3_ego: (F, 4, 4) the ego frame of each instant in that of the first.
        boxes: road users.
        tracks: (F, V, H, W) number of the road user in each pixel, `ABSENT` elsewhere; None: not known.
        lines: lines of the map in the ego frame of the first instant; None: no map is known.
        ego_SE3_view: (F, V, 4, 4) pose of each camera at its own mid-exposure in the ego frame of the frame's instant;
            None: all cameras expose at that instant.
        excluded: (F, V, H, W) pixels that are no truth: outside the lens, on the recording vehicle, redacted, or of a
            road user without a box; None: there are none.
        hidden: (F, V, H, W) share of the static model's training images, in 255ths, in which a road user hides the
            place that a pixel shows; None: not known.
    """

    clip_id: str
    drive_id: str
    rate_hz: float
    views: tuple[str, ...]
    images: UInt8
    background: UInt8
    present: Bool
    intrinsics: Float64
    ego_SE3_camera: Float64
    start_SE3_ego: Float64
    boxes: ClipBoxes
    tracks: AnyArray | None = None
    lines: tuple[MapLine, ...] | None = None
    ego_SE3_view: Float64 | None = None
    excluded: Bool | None = None
    hidden: UInt8 | None = None

    def __post_init__(self) -> None:
        if self.images.ndim != 5 or self.images.shape[1] != len(self.views) or self.images.shape[-1] != 3:
            raise self._error("images", self.images.shape, f"(F, {len(self.views)}, H, W, 3)")
        frames, views, height, width, _ = self.images.shape
        shapes: dict[str, tuple[int, ...]] = {
            "background": self.images.shape,
            "present": (frames, views),
            "intrinsics": (views, 3, 3),
            "ego_SE3_camera": (views, 4, 4),
            "start_SE3_ego": (frames, 4, 4),
            "tracks": (frames, views, height, width),
            "ego_SE3_view": (frames, views, 4, 4),
            "excluded": (frames, views, height, width),
            "hidden": (frames, views, height, width),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise self._error(name, value.shape, str(shape))
        for name in ("intrinsics", "ego_SE3_camera", "start_SE3_ego", "ego_SE3_view"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value).all():
                raise DatasetError(f"{name} is not finite", place=self.clip_id, expected="finite numbers")
        self._check_boxes(frames)
        self._check_lines()

    @property
    def size_px(self) -> tuple[int, int]:
        """Height and width of the images."""
        return self.images.shape[2], self.images.shape[3]

    def __len__(self) -> int:
        return len(self.images)

    def cameras_at(self, frame: int) -> Float64:
        """Return the poses (V, 4, 4) of the cameras of a frame in its ego frame, each at its own mid-exposure."""
        return self.ego_SE3_camera if self.ego_SE3_view is None else self.ego_SE3_view[frame]

    def _error(self, name: str, found: tuple[int, ...], expected: str) -> DatasetError:
        return DatasetError(f"{name} of shape {found}", place=self.clip_id, expected=expected)

    def _check_boxes(self, frames: int) -> None:
        boxes = self.boxes
        finite = np.isfinite(boxes.ego_SE3_box).all(axis=(1, 2)) & (boxes.lwh_m > 0.0).all(axis=1)
        finite &= np.isfinite(boxes.lwh_m).all(axis=1)
        known = (boxes.frame >= 0) & (boxes.frame < frames)
        known &= (boxes.category >= 0) & (boxes.category < len(CATEGORIES))
        for good, expected in ((finite, "finite poses and sizes above 0"), (known, "a frame and a class that exist")):
            if not good.all():
                row = int(np.argmin(good))
                raise DatasetError(
                    f"the box of track {boxes.track[row]} in frame {boxes.frame[row]} is not valid",
                    place=f"{self.clip_id}, box {row}", expected=expected,
                    remedy="leave the box out, or correct it",
                )  # fmt: skip

    def _check_lines(self) -> None:
        for number, line in enumerate(self.lines or ()):
            points = line.points_m
            shaped = points.ndim == 2 and points.shape[1:] == (3,) and len(points) > 1
            if line.kind not in LINE_KINDS or not shaped or not np.isfinite(points).all():
                raise DatasetError(
                    f"line {number} of the map is not valid", place=f"{self.clip_id}, a line of kind {line.kind!r}",
                    expected=f"a kind of {', '.join(LINE_KINDS)}, and two or more finite points (P, 3)",
                    remedy="leave the line out, or correct it",
                )  # fmt: skip
