"""What a viewer of a reconstructed street moves along: recorded images, and appearances from day to night."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.image import Image
from mirror.errors import UsageError
from mirror.geometry.cameras import undistorted
from mirror.geometry.poses import Poses
from mirror.methods.interactive import TrainedAppearance
from mirror.protocols.views.view import RenderView

_WIDEST_RAD: Final = 0.96
_LIGHTS: Final = ("day", "dusk", "night")


@dataclass(frozen=True, eq=False)
class StreetPath:
    """The images of one camera in one traversal.

    Attributes:
        traversal_id: the traversal.
        camera: the camera.
        images: N images in order of time.
        world_SE3_camera: their poses.
        world_SE3_ego: N poses of the vehicle at these images.
        row: row of the traversal in the table ``traversals``.
    """

    traversal_id: str
    camera: str
    images: tuple[Image, ...]
    world_SE3_camera: Poses
    world_SE3_ego: Poses
    row: Mapping[str, object]

    def view(self, number: int, width_px: int, height_px: int, *, left_m: float = 0.0) -> RenderView:
        """Return the view of one image in another raster, from a place shifted to the left.

        Args:
            number: the image.
            width_px: width of the raster.
            height_px: height of the raster; the vertical field of view is that of the undistorted image, at most 55
                degrees.
            left_m: shift to the left of the vehicle; negative: to the right.
        """
        shift = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, left_m, 0.0]]))
        ego = self.world_SE3_ego[number]
        pose = ego @ shift @ ego.inverse() @ self.world_SE3_camera[number]
        lens = self.images[number].camera_model
        pinhole = lens if lens.model == "pinhole" else undistorted(lens)
        focal = max(pinhole.fy_px / pinhole.height_px, 0.5 / np.tan(0.5 * _WIDEST_RAD)) * height_px
        return self.make_view(pose, focal, width_px, height_px, self.images[number].timestamp_ns)

    def make_view(
        self, world_SE3_camera: Poses, focal_px: float, width_px: int, height_px: int, timestamp_ns: int
    ) -> RenderView:
        """Return a view from any place, with the principal point in the middle."""
        return RenderView(
            path="view.png", group="view", scene_id=str(self.row["scene_id"]), traversal_id=self.traversal_id,
            frame_index=0, camera=self.camera, timestamp_ns=timestamp_ns, light=str(self.row["light"]),
            weather=str(self.row["weather"]), model="pinhole", width_px=width_px, height_px=height_px,
            fx_px=focal_px, fy_px=focal_px, cx_px=0.5 * width_px, cy_px=0.5 * height_px, distortion=(),
            world_SE3_camera=world_SE3_camera,
        )  # fmt: skip


def read_path(dataset: Dataset, traversal_id: str, camera: str | None = None) -> StreetPath:
    """List the images of a camera in a traversal; no image is opened.

    Args:
        dataset: the dataset.
        traversal_id: the traversal.
        camera: name of the camera; None: the first of the rig.

    Raises:
        UsageError: the traversal has no image of that camera.
    """
    frames = dataset.where(traversal=traversal_id).frames()
    names = list(frames[0].images) if len(frames) else []
    chosen = camera or (names[0] if names else "")
    images = tuple(frame.images[chosen] for frame in frames if chosen in frame.images)
    if not images:
        raise UsageError(
            f"traversal {traversal_id} has no image of camera {chosen!r}", place="--camera",
            expected=f"one of {', '.join(dataset.cameras())}",
        )  # fmt: skip
    poses = _stack([image.world_SE3_camera for image in images])
    ego = _stack([image.world_SE3_camera @ image.calibration.ego_SE3_camera.inverse() for image in images])
    row = dataset.where(traversal=traversal_id).table("traversals", ["scene_id", "light", "weather"]).to_pylist()[0]
    return StreetPath(traversal_id, chosen, images, poses, ego, row)


def by_light(appearances: Sequence[TrainedAppearance]) -> tuple[TrainedAppearance, ...]:
    """Return the appearances from day to night."""

    def order(item: TrainedAppearance) -> tuple[int, str, str]:
        known = item.light in _LIGHTS
        return (_LIGHTS.index(item.light) if known else len(_LIGHTS), item.weather, item.traversal_id)

    return tuple(sorted(appearances, key=order))


def blend(appearances: Sequence[TrainedAppearance], position: float) -> dict[str, float]:
    """Return the weights at a position between 0 (the first appearance) and ``len(appearances) - 1`` (the last)."""
    low = int(np.clip(np.floor(position), 0, len(appearances) - 1))
    high = min(low + 1, len(appearances) - 1)
    share = float(np.clip(position - low, 0.0, 1.0))
    weights = {appearances[low].traversal_id: 1.0 - share}
    weights[appearances[high].traversal_id] = weights.get(appearances[high].traversal_id, 0.0) + share
    return {name: weight for name, weight in weights.items() if weight > 0.0}


def recorded_pixels(image: Image, width_px: int) -> UInt8:
    """Return the pixels of a recorded image, scaled down to a width."""
    import cv2

    pixels = image.decode()
    height = round(pixels.shape[0] * width_px / pixels.shape[1])
    return np.asarray(cv2.resize(pixels, (width_px, height), interpolation=cv2.INTER_AREA), np.uint8)


def _stack(poses: Sequence[Poses]) -> Poses:
    return Poses(
        np.concatenate([pose.rotation for pose in poses]), np.concatenate([pose.translation for pose in poses])
    )
