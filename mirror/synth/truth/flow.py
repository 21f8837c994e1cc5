"""Optical flow of what stands still: from distances and two poses, exact."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float32
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera


def static_flow(
    distance_m: npt.ArrayLike, camera: Camera, world_SE3_camera: Poses, later: Camera, world_SE3_later: Poses
) -> Float32:
    """How far the point of the world that a pixel shows is away from that pixel in another image.

    The point is taken to stand still: for road users and the recording vehicle itself that is not what they do. Whether
    it is hidden in the other image is not considered. What is infinitely far moves by the rotation alone.

    Args:
        distance_m: (H, W) along the rays of the pixels' centres, infinite in the sky.
        camera: of the image.
        world_SE3_camera: one pose.
        later: camera of the other image, often the same.
        world_SE3_later: one pose.

    Returns:
        (H, W, 2) pixels, to the right and downwards, also beyond the raster; NaN where the other camera has no pixel
        for the point.

    Raises:
        UsageError: the distances are not of the camera's raster.
    """
    distance = np.asarray(distance_m, np.float64)
    if distance.shape != (camera.height_px, camera.width_px):
        raise UsageError(
            f"distances of shape {distance.shape}", expected=f"({camera.height_px}, {camera.width_px}), as the raster"
        )
    later_SE3_camera = world_SE3_later.inverse() @ world_SE3_camera
    turn, shift = matrix_from_quaternion(later_SE3_camera.rotation)[0], later_SE3_camera.translation[0]
    rays = camera.rays().direction @ turn.T
    # In units of the distance: finite in the sky as well.
    seen = later.project(rays + shift / distance[..., None])
    u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    return (seen.uv_px - np.stack([u, v], axis=-1)).astype(np.float32)
