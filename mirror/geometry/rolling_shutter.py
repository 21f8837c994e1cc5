"""Rolling shutters: the time at which each row or column of an image is exposed, and where moving points are seen.

Times are offsets from mid-exposure, which is the instant of an image's pose (docs/conventions.md). The middle of the
first line's exposure is half a readout before it, that of the last line half a readout after it; the time of a place
between the centres of two lines is interpolated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera

ShutterDirection: TypeAlias = Literal["global", "top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"]
SHUTTER_DIRECTIONS: Final[tuple[ShutterDirection, ...]] = get_args(ShutterDirection)

_STEPS: Final = 30
_SETTLED_NS: Final = 1e-3
_BEYOND: Final = 0.6
"""Times are clamped to this share of the readout before and after mid-exposure: to 10 % of the raster beyond it."""


@dataclass(frozen=True)
class RollingShutter:
    """The shutter of a camera.

    Attributes:
        direction: direction in which lines are exposed one after the other.
        readout_ns: from the start of the first line's exposure to the start of the last line's.
        width_px: width of the raster.
        height_px: height of the raster.

    Raises:
        UsageError: the direction is unknown, the raster does not have it, or the readout is negative.
    """

    direction: ShutterDirection
    readout_ns: int
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        if self.direction not in SHUTTER_DIRECTIONS:
            raise UsageError(
                f"no shutter direction {self.direction!r}", place="shutter_direction",
                expected=" or ".join(SHUTTER_DIRECTIONS),
            )  # fmt: skip
        if self.readout_ns < 0:
            raise UsageError(f"a readout of {self.readout_ns} ns", place="readout_ns", expected="at least 0")
        if self.is_rolling and self.lines < 2:
            raise UsageError(
                f"a raster of {self.width_px} x {self.height_px} pixels is not read out {self.direction}",
                place="shutter_direction",
                expected=f"at least two {'columns' if self.reads_columns else 'rows'}",
            )

    @property
    def is_rolling(self) -> bool:
        """Return whether lines are exposed at different times."""
        return self.direction != "global" and self.readout_ns > 0

    @property
    def reads_columns(self) -> bool:
        """Return whether lines are columns."""
        return self.direction in ("left_to_right", "right_to_left")

    @property
    def lines(self) -> int:
        """The number of lines."""
        return self.width_px if self.reads_columns else self.height_px

    def offsets_ns(self, uv_px: npt.ArrayLike) -> Float64:
        """Return the times (...) at which places (..., 2) of the raster are exposed, from mid-exposure, unclamped."""
        uv = np.asarray(uv_px, np.float64)
        if not self.is_rolling:
            return np.zeros(uv.shape[:-1])
        share = (uv[..., 0 if self.reads_columns else 1] - 0.5) / (self.lines - 1) - 0.5
        backward = self.direction in ("bottom_to_top", "right_to_left")
        return np.asarray((-share if backward else share) * self.readout_ns)

    def line_offsets_ns(self) -> Float64:
        """Return the time (L,) of each line, from mid-exposure, in the order of the raster."""
        centres = np.arange(self.lines) + 0.5
        return self.offsets_ns(np.stack([centres, centres], axis=-1))

    def resized(self, width_px: int, height_px: int) -> RollingShutter:
        """Return the shutter of the same image at another size: the raster's edges keep their times."""
        lines = width_px if self.reads_columns else height_px
        if not self.is_rolling:
            return RollingShutter(self.direction, self.readout_ns, width_px, height_px)
        # the centres of the first and the last line move with the width of a line
        readout = self.readout_ns * (self.lines / (self.lines - 1)) * ((lines - 1) / lines)
        return RollingShutter(self.direction, round(readout), width_px, height_px)


def project_rolling(
    camera: Camera, shutter: RollingShutter, count: int, points_at: Callable[[Float64], Float64]
) -> tuple[Float64, Bool, Float64]:
    """Project moving points, each at the time of the line in which it is seen.

    The time is found by the secant method to 1e-3 ns. A point that the camera does not image stays at mid-exposure.

    Args:
        camera: camera of the image.
        shutter: its shutter.
        count: number of points, N.
        points_at: returns the points (N, 3) in the camera frame, point i at offset i of (N,) from mid-exposure, ns.

    Returns:
        Pixels (N, 2), whether (N,) the camera images the point, and the times (N,) from mid-exposure, ns.
    """

    def row_times(offsets: Float64) -> Float64:
        seen = camera.project(points_at(offsets))
        times = shutter.offsets_ns(seen.uv_px)
        limit = _BEYOND * shutter.readout_ns
        return np.asarray(np.where(np.isfinite(times), np.clip(times, -limit, limit), 0.0))

    before = np.zeros(count)
    times = before
    if shutter.is_rolling:
        error_before = row_times(before)
        times = before + error_before
        for _ in range(_STEPS):
            error = row_times(times) - times
            change = error - error_before
            is_flat = np.abs(change) < 1e-12
            step = np.where(is_flat, error, -error * (times - before) / np.where(is_flat, 1.0, change))
            before, error_before = times, error
            times = times + np.clip(step, -shutter.readout_ns, shutter.readout_ns)
            if np.abs(step).max(initial=0.0) < _SETTLED_NS:
                break
    seen = camera.project(points_at(times))
    return seen.uv_px, seen.valid, times
