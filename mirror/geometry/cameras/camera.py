"""A calibrated camera: from points to pixels and from pixels to rays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import AnyArray, Bool, Float32, Float64
from mirror.errors import UsageError
from mirror.geometry.blocks import fill, split
from mirror.geometry.cameras.fisheye import Fisheye, kannala_brandt_polynomial
from mirror.geometry.cameras.perspective import Perspective

COEFFICIENTS: Final = {
    "pinhole": "",
    "brown_conrady": "k1 k2 p1 p2 k3",
    "rational": "k1 k2 p1 p2 k3 k4 k5 k6",
    "kannala_brandt": "k1 k2 k3 k4",
    "f_theta": "c0 c1 c2 ...",
}

Lens = Perspective | Fisheye

# Products of coefficients beyond it overflow where a lens is worked out, and no camera has such numbers.
_LARGEST_NUMBER: Final = 1e12
_SMALLEST_SCALE: Final = 1e-12


@dataclass(frozen=True, eq=False)
class Projection:
    """Image points, with a mask of where the camera model defines them.

    Attributes:
        uv_px: (..., 2) pixels; NaN where the model does not define them: a point that is not finite, behind the camera
            (perspective models: z <= 0) or beyond the range in which the distortion is invertible.
        depth_m: (...) z in the camera frame; below zero for what a fisheye sees beyond 90 degrees.
        valid: (...) defined and within the raster, ``0 <= u < width`` and ``0 <= v < height``.
    """

    uv_px: Float64
    depth_m: Float64
    valid: Bool

    @property
    def defined(self) -> Bool:
        """(...) True where the model defines a pixel, inside or outside the raster."""
        return np.isfinite(self.uv_px[..., 0])


@dataclass(frozen=True, eq=False)
class Rays:
    """Directions of pixels' rays, with a mask of where the camera model defines them.

    Attributes:
        direction: (..., 3) unit vectors in the camera frame; NaN where not valid.
        valid: (...) True where some point is imaged at this pixel; the raster may be left.
    """

    direction: Float64
    valid: Bool


@dataclass(frozen=True)
class Camera:
    """One camera's raster, focal lengths, principal point and distortion.

    The camera frame is x right, y down, z forward. The image's corner is at (0, 0) and the centre of its first pixel at
    (0.5, 0.5), as in COLMAP; OpenCV has that centre at (0, 0), so that ``cx_px`` here is OpenCV's plus 0.5.

    Models (``mirror.geometry.cameras.perspective`` and ``fisheye`` have the formulas) and their coefficients:
    ``pinhole``: none. ``brown_conrady``: k1 k2 p1 p2 k3. ``rational``: k1 k2 p1 p2 k3 k4 k5 k6. ``kannala_brandt``:
    k1 k2 k3 k4, OpenCV's fisheye model. ``f_theta``: c0 c1 c2 ..., the radius in pixels as a polynomial of the angle in
    radians, c0 = 0; its focal lengths are 1 (or the factor by which a calibrated image was scaled).

    Attributes:
        model: one of these names.
        width_px: of the raster.
        height_px: of the raster.
        fx_px: focal length along x.
        fy_px: focal length along y.
        cx_px: principal point.
        cy_px: principal point.
        distortion: the model's coefficients.

    Raises:
        UsageError: the model is unknown, has another number of coefficients, or a number makes no camera.
    """

    model: str
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _require_camera(self)

    @cached_property
    def lens(self) -> Lens:
        """The distortion, in units of the focal length."""
        if self.model == "kannala_brandt":
            return Fisheye(kannala_brandt_polynomial(self.distortion))
        if self.model == "f_theta":
            return Fisheye(self.distortion)
        across = max(self.cx_px, self.width_px - self.cx_px) / self.fx_px
        down = max(self.cy_px, self.height_px - self.cy_px) / self.fy_px
        return Perspective(self.distortion, reach=float(np.hypot(across, down)))

    @property
    def angle_limit_rad(self) -> float:
        """Angle from the optical axis up to which the model is invertible and points have pixels."""
        return self.lens.angle_limit

    def project(self, points_camera: npt.ArrayLike) -> Projection:
        """Project points to the image.

        Args:
            points_camera: (..., 3) in the camera frame, in metres.

        Raises:
            UsageError: the last axis is not 3.

        Example:
            >>> from mirror.geometry import Camera
            >>> camera = Camera("pinhole", 200, 100, fx_px=100.0, fy_px=100.0, cx_px=100.0, cy_px=50.0)
            >>> camera.project([[1.0, 0.0, 5.0]]).uv_px
            array([[120.,  50.]])
        """
        points = _vectors(points_camera, 3, "points")
        batch = points.shape[:-1]
        points = points.reshape(-1, 3)
        uv, depth, valid = np.empty((len(points), 2)), np.empty(len(points)), np.empty(len(points), dtype=np.bool_)
        with np.errstate(all="ignore"):
            fill(self._project_kernel, uv, depth[:, None], valid[:, None], points)
        return Projection(uv.reshape(*batch, 2), depth.reshape(batch), valid.reshape(batch))

    def unproject(self, uv_px: npt.ArrayLike) -> Rays:
        """Return the rays of pixels: the inverse of `project`, accurate to rounding (1e-9 px or better).

        Args:
            uv_px: (..., 2).

        Raises:
            UsageError: the last axis is not 2.
        """
        pixels = _vectors(uv_px, 2, "pixels")
        batch = pixels.shape[:-1]
        pixels = pixels.reshape(-1, 2)
        direction, valid = np.empty((len(pixels), 3)), np.empty(len(pixels), dtype=np.bool_)
        with np.errstate(all="ignore"):
            fill(self._unproject_kernel, direction, valid[:, None], pixels)
        return Rays(direction.reshape(*batch, 3), valid.reshape(batch))

    def rays(self) -> Rays:
        """Return the rays (height, width) of all pixel centres."""
        u, v = np.meshgrid(np.arange(self.width_px) + 0.5, np.arange(self.height_px) + 0.5)
        return self.unproject(np.stack((u, v), axis=-1))

    def intrinsic_matrix(self, *, first_pixel_centre: float = 0.5) -> Float64:
        """Return the matrix K (3, 3) for pixel coordinates in which the first pixel's centre has the given value."""
        shift = first_pixel_centre - 0.5
        return np.array([[self.fx_px, 0.0, self.cx_px + shift], [0.0, self.fy_px, self.cy_px + shift], [0.0, 0.0, 1.0]])

    def resized(self, width_px: int, height_px: int) -> Camera:
        """Return the camera that describes this camera's images after scaling to another raster."""
        across, down = width_px / self.width_px, height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * across,
            fy_px=self.fy_px * down,
            cx_px=self.cx_px * across,
            cy_px=self.cy_px * down,
        )

    def scaled(self, factor: float) -> Camera:
        """Return the camera that describes this camera's images after scaling, to the nearest whole raster."""
        return self.resized(round(self.width_px * factor), round(self.height_px * factor))

    def cropped(self, left_px: int, top_px: int, width_px: int, height_px: int) -> Camera:
        """Return the camera that describes a rectangle of this camera's images; it may reach beyond them."""
        return replace(
            self, width_px=width_px, height_px=height_px, cx_px=self.cx_px - left_px, cy_px=self.cy_px - top_px
        )

    def to_row(self) -> dict[str, Any]:
        """Return the values of this camera by column of the ``calibrations`` table; `camera_from_row` reads them."""
        return {name: getattr(self, name) for name in _COLUMNS}

    def undistort_maps(self, target: Camera) -> tuple[Float32, Float32]:
        """Compute, for each pixel of a target camera at the same place, its position in this camera's images.

        Returns:
            Two (H, W) maps for ``cv2.remap``, in OpenCV's pixel coordinates; -1 where this camera sees nothing.
        """
        seen = self.project(target._planar() if target.lens.straight else target.rays().direction)
        maps = np.where(seen.defined[..., None], seen.uv_px - 0.5, -1.0).astype(np.float32)
        return np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1])

    def _planar(self) -> Float64:
        """(height, width, 3) directions of a pinhole's pixel centres, of no unit length: cheaper than rays."""
        direction = np.ones((self.height_px, self.width_px, 3))
        direction[..., 0] = (np.arange(self.width_px) + 0.5 - self.cx_px) / self.fx_px
        direction[..., 1] = ((np.arange(self.height_px) + 0.5 - self.cy_px) / self.fy_px)[:, None]
        return direction

    def _project_kernel(self, uv: AnyArray, depth: AnyArray, valid: AnyArray, points: AnyArray) -> None:
        x, y, z = split(points)
        u, v, inside = self.lens.project(x, y, z)
        u, v = self.fx_px * u + self.cx_px, self.fy_px * v + self.cy_px
        inside &= np.isfinite(u + v)
        uv[:, 0] = np.where(inside, u, np.nan)
        uv[:, 1] = np.where(inside, v, np.nan)
        depth[:, 0] = z
        valid[:, 0] = inside & (u >= 0.0) & (u < self.width_px) & (v >= 0.0) & (v < self.height_px)

    def _unproject_kernel(self, direction: AnyArray, valid: AnyArray, pixels: AnyArray) -> None:
        u, v = split(pixels)
        *ray, inside = self.lens.unproject((u - self.cx_px) / self.fx_px, (v - self.cy_px) / self.fy_px)
        for axis, component in enumerate(ray):
            direction[:, axis] = np.where(inside, component, np.nan)
        valid[:, 0] = inside


_COLUMNS: Final = tuple(field.name for field in fields(Camera))


def camera_from_row(row: Mapping[str, Any]) -> Camera:
    """Return the camera of one row of the ``calibrations`` table, or of one entry of a calibration file.

    Raises:
        UsageError: a key is missing or its value makes no camera; the camera is named.
    """
    place = f"camera {row['camera']}" if "camera" in row else None
    try:
        return Camera(
            model=str(row["model"]),
            width_px=int(row["width_px"]),
            height_px=int(row["height_px"]),
            fx_px=float(row["fx_px"]),
            fy_px=float(row["fy_px"]),
            cx_px=float(row["cx_px"]),
            cy_px=float(row["cy_px"]),
            distortion=tuple(float(value) for value in row["distortion"]),
        )
    except KeyError as error:
        raise UsageError(f"no value for {error}", place=place, expected="a row of the calibrations table") from error
    except (TypeError, ValueError) as error:
        raise UsageError(f"not a number: {error}", place=place, expected="a row of the calibrations table") from error
    except UsageError as error:
        raise UsageError(error.problem, place=place, expected=error.expected, remedy=error.remedy) from error


def camera_from_attributes(source: object) -> Camera:
    """Return the camera that the attributes ``model``, ``width_px`` ... ``distortion`` of an object describe.

    Raises:
        UsageError: the values make no camera.
    """
    return Camera(**{name: getattr(source, name) for name in _COLUMNS})


def _require_camera(camera: Camera) -> None:
    place = f"camera model {camera.model}"
    names = COEFFICIENTS.get(camera.model)
    if names is None:
        raise UsageError(f"no camera model {camera.model!r}", expected=f"one of {', '.join(COEFFICIENTS)}")
    given = camera.distortion
    if camera.model == "f_theta":
        fits = len(given) >= 2 and given[0] == 0.0 and given[1] >= _SMALLEST_SCALE
        expected = "c0 c1 c2 ... with c0 = 0 (the axis is imaged at the principal point) and c1 > 0"
    else:
        fits = len(given) == len(names.split())
        expected = f"{len(names.split())} coefficients: {names or 'none'}"
    if not fits:
        raise UsageError(f"distortion {list(given)}", place=place, expected=expected)
    numbers = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *given)
    in_range = (np.abs(numbers) <= _LARGEST_NUMBER).all()
    if not in_range or min(camera.fx_px, camera.fy_px) < _SMALLEST_SCALE:
        raise UsageError(
            f"focal lengths, principal point, distortion {numbers}",
            place=place,
            expected=f"finite, no number beyond {_LARGEST_NUMBER:g}, fx, fy > 0",
        )
    if camera.width_px <= 0 or camera.height_px <= 0:
        raise UsageError(f"raster {camera.width_px} x {camera.height_px}", place=place, expected="at least one pixel")


def _vectors(values: npt.ArrayLike, count: int, what: str) -> Float64:
    given = np.asarray(values, dtype=np.float64)
    if given.ndim == 0 or given.shape[-1] != count:
        raise UsageError(f"{what} of shape {given.shape}", expected=f"shape (..., {count})")
    return given
