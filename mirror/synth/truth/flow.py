"""Exact optical flow of the static world, from distances and two poses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float32, Float64
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.geometry.quaternions import rotate
from mirror.geometry.rolling_shutter import RollingShutter, project_rolling
from mirror.portable import arrays


def static_flow(
    distance_m: npt.ArrayLike, camera: Camera, world_SE3_camera: Poses, later: Camera, world_SE3_later: Poses
) -> Float32:
    """Compute the optical flow from one image to another for a static world.

    Every point is assumed to be static, which is wrong for road users and for the recording vehicle. Occlusion in the
    other image is not considered. Points at infinity move by the rotation only.

    Args:
        distance_m: (H, W) distances along the rays through the pixel centres, infinite for the sky.
        camera: camera of the image.
        world_SE3_camera: one pose of the camera.
        later: camera of the other image, often the same.
        world_SE3_later: one pose of the other camera.

    Returns:
        (H, W, 2) flow in pixels, right and down, also to points outside the raster; NaN where the other camera does
        not image the point.

    Raises:
        UsageError: the shape of the distances is not the camera's raster.
    """
    distance = _check_distances(distance_m, camera)
    later_SE3_camera = world_SE3_later.inverse() @ world_SE3_camera
    turn, shift = matrix_from_quaternion(later_SE3_camera.rotation)[0], later_SE3_camera.translation[0]
    rays = arrays.matmul(camera.rays().direction, turn.T)
    # In units of the distance: finite in the sky as well.
    projected = later.project(rays + shift / distance[..., None])
    u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    return (projected.uv_px - np.stack([u, v], axis=-1)).astype(np.float32)


def rolling_flow(
    distance_m: npt.ArrayLike,
    camera: Camera,
    shutter: RollingShutter,
    poses_at: Callable[[Float64], Poses],
    later_at: Callable[[Float64], Poses],
) -> Float32:
    """Compute `static_flow` between two images of one camera whose lines are exposed one after the other.

    Each pixel starts at the time of its own line, and ends at the time of the line in which its point is seen later.

    Args:
        distance_m: (H, W) distances along the rays, each at the time of its line.
        camera: camera of both images.
        shutter: its shutter.
        poses_at: returns world_SE3_camera at offsets (N,) from the first image's mid-exposure, ns.
        later_at: the same of the later image.

    Returns:
        (H, W, 2) flow in pixels; NaN where the camera does not image the point.
    """
    distance = _check_distances(distance_m, camera)
    u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    here = poses_at(shutter.offsets_ns(uv))
    directions = rotate(here.rotation, camera.rays().direction.reshape(-1, 3))
    far = distance.reshape(-1, 1)

    def points_at(offsets_ns: Float64) -> Float64:
        there = later_at(offsets_ns)
        # In units of the distance: finite in the sky as well.
        shift = (here.translation - there.translation) / far
        return rotate(there.inverse().rotation, directions + shift)

    seen, _, _ = project_rolling(camera, shutter, len(uv), points_at)
    return (seen - uv).reshape(*distance.shape, 2).astype(np.float32)


def _check_distances(distance_m: npt.ArrayLike, camera: Camera) -> Float64:
    distance = np.asarray(distance_m, np.float64)
    if distance.shape != (camera.height_px, camera.width_px):
        raise UsageError(
            f"distances of shape {distance.shape}", expected=f"({camera.height_px}, {camera.width_px}), as the raster"
        )
    return distance
