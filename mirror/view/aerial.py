"""An aerial image or a map from a file, cut to a scene's map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.errors import UsageError
from mirror.geometry.geodesy import ecef_R_enu, ecef_to_geodetic, geodetic_to_ecef

_FINER: Final = 1.5
"""A file with more pixels than this for each pixel of a cut is averaged first."""


@dataclass(frozen=True)
class AerialImage:
    """An image of the ground whose columns are even steps of longitude and whose rows are even steps of latitude.

    Attributes:
        path: PNG or JPEG; north is up.
        bounds_deg: west, south, east and north edge, WGS 84.

    Raises:
        UsageError: the bounds are not in this order, or are no longitudes and latitudes.
    """

    path: Path
    bounds_deg: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        west, south, east, north = self.bounds_deg
        if not (-180.0 <= west < east <= 180.0 and -90.0 <= south < north <= 90.0):
            raise UsageError(
                f"bounds {', '.join(f'{value:g}' for value in self.bounds_deg)}",
                place="--aerial-bounds",
                expected="west, south, east, north in degrees, west < east and south < north",
            )

    @cached_property
    def _pixels(self) -> UInt8:
        import cv2

        try:
            data = np.fromfile(self.path, np.uint8)
        except OSError as error:
            raise UsageError("cannot be read", file=self.path, place="--aerial", expected="an image file") from error
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
        if image is None:
            raise UsageError("no image", file=self.path, place="--aerial", expected="a PNG or JPEG file")
        return np.asarray(image[..., ::-1], np.uint8)

    def cut(self, longitude_deg: float, latitude_deg: float, reach_m: float, side_px: int) -> UInt8 | None:
        """Cut the square around a place, with north up, as the plane that touches the ground there shows it.

        Args:
            longitude_deg: middle of the square, WGS 84.
            latitude_deg: middle of the square, WGS 84.
            reach_m: half the side of the square.
            side_px: its side in pixels.

        Returns:
            (side_px, side_px, 3) RGB, grey outside the file's bounds; None: the place lies outside.

        Raises:
            UsageError: the file is no image.
        """
        import cv2

        west, south, east, north = self.bounds_deg
        if not (west <= longitude_deg <= east and south <= latitude_deg <= north):
            return None
        height, width = self._pixels.shape[:2]
        steps = (np.arange(side_px) + 0.5) / side_px * 2.0 - 1.0
        x, y = np.meshgrid(reach_m * steps, -reach_m * steps)
        lon, lat = _to_geodetic(longitude_deg, latitude_deg, np.column_stack([x.ravel(), y.ravel()]))
        columns = ((lon - west) / (east - west) * width - 0.5).reshape(side_px, side_px)
        rows = ((north - lat) / (north - south) * height - 0.5).reshape(side_px, side_px)
        if not (columns.max() > 0 and columns.min() < width - 1 and rows.max() > 0 and rows.min() < height - 1):
            return None
        image = self._pixels
        finer = max((columns.max() - columns.min()) / side_px, (rows.max() - rows.min()) / side_px)
        if finer > _FINER:
            scale = 1.0 / finer
            size = (max(round(width * scale), 1), max(round(height * scale), 1))
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
            columns = (columns + 0.5) * size[0] / width - 0.5
            rows = (rows + 0.5) * size[1] / height - 0.5
        cut = cv2.remap(
            image,
            columns.astype(np.float32),
            rows.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(128, 128, 128),
        )
        return np.asarray(cut, np.uint8)


def _to_geodetic(longitude_deg: float, latitude_deg: float, east_north_m: Float64) -> tuple[Float64, Float64]:
    """Map points (N, 2) of the tangent plane at a place to longitudes and latitudes."""
    plane = np.column_stack([east_north_m, np.zeros(len(east_north_m))])
    points = geodetic_to_ecef(longitude_deg, latitude_deg) + plane @ ecef_R_enu(longitude_deg, latitude_deg).T
    longitudes, latitudes, _ = ecef_to_geodetic(points)
    return longitudes, latitudes
