"""Rolling shutters of cameras that move: the poses of the lines of an image, and bands of lines that share one pose."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from hybridworldsim.simulator.policies.protocol import Readout
from mirror.arrays import Float64
from mirror.geometry import Poses, interpolate, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import RollingShutter
from mirror.protocols.views.rolling import fit_line_times
from mirror.protocols.views.view import ViewShutter

_BANDS: Final = 24


class Band(NamedTuple):
    """Neighbouring lines of an image that count as exposed at one time.

    Attributes:
        place: rows and columns of the band.
        lens: (4,) fx, fy, cx, cy of the part of the image.
        offset_s: its time, from mid-exposure.
        rotation: (3, 3) world_R_camera then.
        origin: (3,) position of the camera then.
    """

    place: tuple[slice, slice]
    lens: Float64
    offset_s: float
    rotation: Float64
    origin: Float64


def fit_readout(camera: Camera, shutter: RollingShutter | None, final: Camera) -> Readout | None:
    """Fit the readout of a final raster to the shutter of a camera; None if it is global.

    Args:
        camera: recorded camera.
        shutter: its shutter; None: global.
        final: camera of the final raster, at the same position.
    """
    if shutter is None or not shutter.is_rolling:
        return None
    times = fit_line_times(camera, shutter, final)
    return Readout(shutter.direction, times.first_ns, times.last_ns)  # type: ignore[arg-type]


def make_shutter(readout: Readout, world_SE3_ends: Poses) -> ViewShutter:
    """Make the shutter of a view from a readout and the camera's two poses at its ends."""
    return ViewShutter(
        direction=readout.direction, first_ns=readout.first_ns, last_ns=readout.last_ns,
        world_SE3_first=world_SE3_ends[:1], world_SE3_last=world_SE3_ends[1:],
    )  # fmt: skip


def reads_columns(shutter: ViewShutter) -> bool:
    """Return whether lines are columns."""
    return shutter.direction in ("left_to_right", "right_to_left")


def line_times(shutter: ViewShutter, camera: Camera) -> Float64:
    """Return the time (L,) of each line from mid-exposure, in the order of the raster, seconds."""
    lines = camera.width_px if reads_columns(shutter) else camera.height_px
    times = 1e-9 * np.linspace(shutter.first_ns, shutter.last_ns, lines)
    return times[::-1] if shutter.direction in ("bottom_to_top", "right_to_left") else times


def poses_at(shutter: ViewShutter, offsets_s: Float64) -> Poses:
    """Return the camera's poses at times (N,) from mid-exposure, seconds; beyond the readout it keeps its velocity."""
    ends = Poses(
        np.concatenate([shutter.world_SE3_first.rotation, shutter.world_SE3_last.rotation]),
        np.concatenate([shutter.world_SE3_first.translation, shutter.world_SE3_last.translation]),
    )
    stamps = np.round([shutter.first_ns, shutter.last_ns]).astype(np.int64)
    return interpolate(stamps, ends, np.round(1e9 * offsets_s).astype(np.int64), extrapolate=True)


def cut_bands(camera: Camera, world_SE3_camera: Poses, shutter: ViewShutter | None) -> Iterator[Band]:
    """Yield the bands of an image: one of all lines if its shutter is global, else `_BANDS`."""
    lens = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    if shutter is None:
        rotation, origin = matrix_from_quaternion(world_SE3_camera.rotation)[0], world_SE3_camera.translation[0]
        yield Band((slice(None), slice(None)), lens, 0.0, rotation, origin)
        return
    columns, times = reads_columns(shutter), line_times(shutter, camera)
    edges = np.unique(np.round(np.linspace(0.0, len(times), _BANDS + 1)).astype(np.int64))
    middles = np.array([times[first:last].mean() for first, last in pairwise(edges.tolist())])
    poses = poses_at(shutter, middles)
    rotations = matrix_from_quaternion(poses.rotation)
    for number, (first, last) in enumerate(pairwise(edges.tolist())):
        lines, shift = slice(first, last), np.array([0.0, 0.0, first, 0.0] if columns else [0.0, 0.0, 0.0, first])
        place = (slice(None), lines) if columns else (lines, slice(None))
        yield Band(place, lens - shift, float(middles[number]), rotations[number], poses.translation[number])
