"""Rolling shutters of views: the times of a final raster's lines, and road users where the lines see them."""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple, cast

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.image import Image
from mirror.geometry.boxes import edge_points
from mirror.geometry.cameras import Camera
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.geometry.rolling_shutter import RollingShutter, project_rolling
from mirror.protocols.views.view import RenderView, RollingDirection, ViewShutter

_GRID: Final = 33


class LineTimes(NamedTuple):
    """The times of a final raster's lines: a line that is fitted to the times of the recorded pixels.

    Attributes:
        first_ns: time of the line that is exposed first, from mid-exposure.
        last_ns: time of the line that is exposed last.
        residual_ns: greatest distance of a pixel's time from that of its line. It is 0 if the final raster is a scaled
            recorded one; an undistorted row is no recorded one.
    """

    first_ns: float
    last_ns: float
    residual_ns: float


@lru_cache(256)
def fit_line_times(camera: Camera, shutter: RollingShutter, final: Camera) -> LineTimes:
    """Fit the times of the lines of a final raster by least squares over its pixels.

    Args:
        camera: recorded camera.
        shutter: its rolling shutter.
        final: camera of the final raster, at the same position.
    """
    u, v = np.meshgrid(np.linspace(0.5, final.width_px - 0.5, _GRID), np.linspace(0.5, final.height_px - 0.5, _GRID))
    rays = final.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    recorded = camera.project(rays.direction)
    seen = rays.valid & recorded.valid
    lines = (u if shutter.reads_columns else v).ravel()[seen]
    times = shutter.offsets_ns(recorded.uv_px[seen])
    slope, constant = np.polyfit(lines, times, 1)
    count = final.width_px if shutter.reads_columns else final.height_px
    ends = sorted((slope * 0.5 + constant, slope * (count - 0.5) + constant))
    residual = float(np.abs(slope * lines + constant - times).max())
    return LineTimes(float(ends[0]), float(ends[1]), residual)


def plan_shutter(image: Image, final: Camera, camera_SE3_moved: Poses | None = None) -> ViewShutter | None:
    """Plan the shutter of a view of a recorded image; None if the calibration says that the shutter is global.

    Args:
        image: recorded image.
        final: camera of the view.
        camera_SE3_moved: pose of the view's camera in that of the recorded one; None: they are the same.

    Raises:
        DatasetError: the poses do not cover the readout.
    """
    shutter = image.shutter
    if not shutter.is_rolling:
        return None
    times = fit_line_times(image.camera_model, shutter, final)
    ends = image.world_SE3_camera_at([times.first_ns, times.last_ns])
    if camera_SE3_moved is not None:
        ends = ends @ camera_SE3_moved
    return make_view_shutter(shutter, times, ends)


def make_view_shutter(shutter: RollingShutter, times: LineTimes, world_SE3_ends: Poses) -> ViewShutter:
    """Make the shutter of a view from the times of its first and last lines, and the two poses at these."""
    return ViewShutter(
        direction=cast(RollingDirection, shutter.direction),
        first_ns=times.first_ns,
        last_ns=times.last_ns,
        world_SE3_first=world_SE3_ends[:1],
        world_SE3_last=world_SE3_ends[1:],
    )


def rolling_hull_points(view: RenderView, world_SE3_box: Poses, size_m: Float64, velocity_mps: Float64) -> Float64:
    """Return pixels (P, 2) on the edges of a moving box, each where its line sees it; NaN where it has no pixel.

    Args:
        view: a view with a rolling shutter.
        world_SE3_box: one pose of the box at mid-exposure.
        size_m: (3,) length, width, height.
        velocity_mps: (3,) velocity in the world frame; NaN counts as 0.
    """
    shutter = view.shutter
    if shutter is None:
        raise ValueError("a view with a global shutter")
    points = edge_points(world_SE3_box, size_m[None])[0]
    velocity = np.nan_to_num(np.asarray(velocity_mps, np.float64))
    poses = Poses(
        np.concatenate([shutter.world_SE3_first.rotation, shutter.world_SE3_last.rotation]),
        np.concatenate([shutter.world_SE3_first.translation, shutter.world_SE3_last.translation]),
    )
    span_ns = shutter.last_ns - shutter.first_ns
    middle_ns = 0.5 * (shutter.first_ns + shutter.last_ns)
    readout = RollingShutter(shutter.direction, round(span_ns), view.width_px, view.height_px)
    stamps = np.array([0, round(span_ns)])

    def points_at(offsets_ns: Float64) -> Float64:
        at = np.clip(np.round(offsets_ns + 0.5 * span_ns), 0, stamps[1]).astype(np.int64)
        cameras = interpolate(stamps, poses, at)
        moved = points + 1e-9 * (offsets_ns + middle_ns)[:, None] * velocity
        return np.asarray(cameras.inverse().transform(moved[:, None])[:, 0])

    seen, _, _ = project_rolling(view.lens, readout, len(points), points_at)
    return seen
