"""The cameras of a traversal as the generator sees them: pinholes of one raster."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, UInt8
from mirror.dataset.frames import Frame, FrameSequence
from mirror.dataset.raster import ImageRaster
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.protocols.document import Pixels
from mirror.protocols.views.final_camera import full_camera
from mirror.protocols.views.recalibration import lens_in_raster
from mirror.protocols.views.view import RenderView

GROUP: Final = "generated"


@dataclass(frozen=True, eq=False)
class SceneRig:
    """V cameras with a raster of (height, width) pixels for all.

    Attributes:
        cameras: V names.
        lenses: V recorded lenses.
        ego_SE3_camera: V poses.
        size_px: height and width of the generator's images.
        pixels: how lenses are undistorted.
        recalibrated: V lenses of another layer of calibrations, through which the rasters are seen; None: the recorded
            ones.
    """

    cameras: tuple[str, ...]
    lenses: tuple[Camera, ...]
    ego_SE3_camera: Poses
    size_px: tuple[int, int]
    pixels: Pixels
    recalibrated: tuple[Camera, ...] | None = None

    @cached_property
    def rasters(self) -> tuple[ImageRaster, ...]:
        """The rasters that map recorded images to the generator's size, by camera."""
        height, width = self.size_px
        full = [full_camera(lens, self.pixels) for lens in self.lenses]
        return tuple(ImageRaster(lens, one, one.resized(width, height)) for lens, one in zip(self.lenses, full))

    @cached_property
    def unscaled_lenses(self) -> tuple[Camera, ...]:
        """The lenses of the rasters before scaling, by camera."""
        full = [raster.full for raster in self.rasters]
        if self.recalibrated is None:
            return tuple(full)
        return tuple(lens_in_raster(*lenses) for lenses in zip(full, self.lenses, self.recalibrated))

    @property
    def intrinsics(self) -> Float64:
        """(V, 3, 3) pixels of the generator's images."""
        return np.stack([self.raster_lens(row).intrinsic_matrix() for row in range(len(self.cameras))])

    def raster_lens(self, row: int) -> Camera:
        """Return the lens of a camera's image in the generator's raster."""
        height, width = self.size_px
        return self.unscaled_lenses[row].resized(width, height)

    def view_lens(self, row: int) -> Camera:
        """Return the lens of a camera's background, at twice the generator's raster, limited to the recorded raster."""
        full, (height, width) = self.unscaled_lenses[row], self.size_px
        return full.resized(min(full.width_px, 2 * width), min(full.height_px, 2 * height))

    def at_calibrations(self, frames: FrameSequence) -> SceneRig:
        """Return the rig with other calibrations of the traversal, in the same rasters.

        Args:
            frames: the traversal's frames with these calibrations.
        """
        other = rig_of(frames, self.cameras, self.size_px, self.pixels)
        return replace(self, ego_SE3_camera=other.ego_SE3_camera, recalibrated=other.lenses)

    def images(self, frame: Frame) -> tuple[UInt8, Bool]:
        """Return a frame's images (V, H, W, 3) in the generator's raster, and a mask (V, H, W) of pixels of the street.

        Pixels outside the lens, on the recording vehicle, and of a missing image are not of the street.
        """
        images = np.zeros((len(self.cameras), *self.size_px, 3), np.uint8)
        street = np.zeros(images.shape[:3], np.bool_)
        for row, camera in enumerate(self.cameras):
            if camera not in frame.images:
                continue
            raster, image = self.rasters[row], frame.images[camera]
            images[row] = raster.image(image.decode())
            ego = image.static_mask()
            street[row] = raster.covered if ego is None else raster.covered & (raster.mask(ego) == 0)
        return images, street

    def views(self, frame: Frame, world_SE3_ego: Poses, light: str, weather: str) -> list[RenderView]:
        """Return the views of a frame from one ego pose, with the lenses to which images are undistorted."""
        views = []
        for row, camera in enumerate(self.cameras):
            lens = self.view_lens(row)
            views.append(
                RenderView(
                    path=f"frames/{camera}/{frame.frame_index:05d}.png",
                    group=GROUP,
                    scene_id=frame.scene_id,
                    traversal_id=frame.traversal_id,
                    frame_index=frame.frame_index,
                    camera=camera,
                    timestamp_ns=frame.timestamp_ns,
                    light=light,
                    weather=weather,
                    **lens.to_row(),
                    world_SE3_camera=world_SE3_ego @ self.ego_SE3_camera[row],
                )
            )
        return views


def rig_of(
    frames: FrameSequence, cameras: tuple[str, ...] | None, size_px: tuple[int, int], pixels: Pixels
) -> SceneRig:
    """Return the rig of a traversal.

    Args:
        frames: the traversal's frames.
        cameras: names; None: all cameras of the first frame.
        size_px: height and width of the generator's images.
        pixels: how lenses are undistorted.

    Raises:
        UsageError: a camera is unknown, or named twice.
    """
    images = {camera: image for frame in frames[:50] for camera, image in frame.images.items()}
    unknown = sorted(set(cameras or ()) - set(images))
    if unknown or not images:
        raise UsageError(
            f"no camera {', '.join(unknown)}" if unknown else "a traversal without images",
            place="--cameras",
            expected=", ".join(sorted(images)) or "images",
        )
    names = cameras or tuple(images)
    if len(set(names)) < len(names):
        raise UsageError(f"{', '.join(names)}", place="--cameras", expected="each camera once")
    mounts = [images[name].calibration.ego_SE3_camera for name in names]
    poses = Poses(np.concatenate([one.rotation for one in mounts]), np.concatenate([one.translation for one in mounts]))
    return SceneRig(names, tuple(images[name].camera_model for name in names), poses, size_px, pixels)
