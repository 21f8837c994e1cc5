"""The restrictions of a view of a dataset."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.geometry.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M, surface_distance_m

MAX_RADIUS_M: Final = 20_000.0
# The smallest radius of curvature of the ellipsoid: a degree of latitude is nowhere shorter than on this sphere.
_SMALLEST_CURVATURE_M: Final = 6_335_439.0
# Below this latitude and up to this distance, the error bound of distances on the tangent plane holds.
_PLANAR_BELOW_DEG: Final = 85.0
_PLANAR_WITHIN_M: Final = 250_000.0


@dataclass(frozen=True)
class Circle:
    """A circle on the WGS 84 ellipsoid, including its edge.

    Attributes:
        longitude_deg: longitude of the centre.
        latitude_deg: latitude of the centre.
        radius_m: geodesic radius on the surface.
    """

    longitude_deg: float
    latitude_deg: float
    radius_m: float

    def __post_init__(self) -> None:
        _check_radius(self.radius_m)
        if not (-180.0 <= self.longitude_deg <= 180.0 and -90.0 <= self.latitude_deg <= 90.0):
            raise UsageError(
                f"({self.longitude_deg}, {self.latitude_deg}) is no place",
                place="within",
                expected="(longitude, latitude, radius_m), degrees of WGS 84",
                remedy="swap longitude and latitude" if abs(self.longitude_deg) <= 90.0 else None,
            )

    def contains(self, longitude_deg: Float64, latitude_deg: Float64) -> Bool:
        """Mark the places (N,) in the circle.

        Distances are geodesic, to 1e-4 m at 20 km; NaN is in no circle.

        Only places near the edge or very far away are measured on the ellipsoid; for the others, the distance on the
        tangent plane is sufficient.
        """
        if abs(self.latitude_deg) > _PLANAR_BELOW_DEG:
            return self._is_within_geodesic(longitude_deg, latitude_deg)
        planar, margin = self._planar_m(longitude_deg, latitude_deg), self._planar_error_m
        inside = planar <= self.radius_m - margin
        undecided = ~inside & ((planar < self.radius_m + 4.0 * margin) | (planar > _PLANAR_WITHIN_M))
        if undecided.any():
            rows = np.flatnonzero(undecided)
            inside[rows] = self._is_within_geodesic(longitude_deg[rows], latitude_deg[rows])
        return inside

    def covers(self, west: Float64, east: Float64, south: Float64, north: Float64) -> Bool:
        """Mark the boxes (N,) of longitudes and latitudes that certainly lie inside; False for NaN boxes."""
        if abs(self.latitude_deg) > _PLANAR_BELOW_DEG:
            return np.zeros(len(west), np.bool_)
        # On the plane a box is a rectangle; its farthest point is a corner.
        corners = [self._planar_m(lon, lat) for lon in (west, east) for lat in (south, north)]
        return (east - west < 180.0) & (np.max(corners, axis=0) <= self.radius_m - self._planar_error_m)

    def _planar_m(self, longitude_deg: Float64, latitude_deg: Float64) -> Float64:
        """Distances (N,) from the centre on the tangent plane, from the length of a degree at the centre."""
        lat = np.radians(self.latitude_deg)
        inner = 1.0 - ECCENTRICITY_SQUARED * np.sin(lat) ** 2
        normal = SEMI_MAJOR_M / np.sqrt(inner)
        meridian = normal * (1.0 - ECCENTRICITY_SQUARED) / inner
        turn = longitude_deg - self.longitude_deg
        if np.max(np.abs(turn), initial=0.0) > 180.0:
            turn = (turn + 180.0) % 360.0 - 180.0
        return np.hypot(
            turn * np.radians(normal * np.cos(lat)), (latitude_deg - self.latitude_deg) * np.radians(meridian)
        )

    @property
    def _planar_error_m(self) -> float:
        """Bound of the error of the planar distance at a distance of one radius.

        Per radian, cos(latitude) changes by tan(latitude), and half of that enters the distance. The radii of curvature
        change by 1 %. The error grows with the square of the distance.
        """
        slope = abs(np.tan(np.radians(self.latitude_deg))) + 0.1
        return float(slope * self.radius_m**2 / _SMALLEST_CURVATURE_M + 1e-3)

    def _is_within_geodesic(self, longitude_deg: Float64, latitude_deg: Float64) -> Bool:
        distance = surface_distance_m(longitude_deg, latitude_deg, self.longitude_deg, self.latitude_deg)
        return distance <= self.radius_m

    def touches(self, west: Float64, east: Float64, south: Float64, north: Float64) -> Bool:
        """Mark the boxes (N,) of longitudes and latitudes that may overlap the circle; False for NaN boxes."""
        height = np.degrees(self.radius_m / _SMALLEST_CURVATURE_M) * (1 + 1e-9)
        low, high = self.latitude_deg - height, self.latitude_deg + height
        in_latitude = (south <= high) & (north >= low)
        steepest = np.radians(max(abs(low), abs(high)))
        if steepest >= np.radians(89.9):
            return in_latitude
        # sin(width) = sin(radius) / cos(latitude) on a sphere; the steepest latitude and curvature bound it from above.
        width = np.degrees(np.arcsin(min(1.0, np.sin(np.radians(height)) / np.cos(steepest))))
        overlaps = np.zeros(len(west), np.bool_)
        for turn in (-360.0, 0.0, 360.0):
            overlaps |= (west <= self.longitude_deg + turn + width) & (east >= self.longitude_deg + turn - width)
        return in_latitude & overlaps


@dataclass(frozen=True)
class LocalCircle:
    """A circle in a local metric frame, including its edge.

    Attributes:
        frame: name of the frame.
        x_m: x of the centre.
        y_m: y of the centre.
        radius_m: radius.
    """

    frame: str
    x_m: float
    y_m: float
    radius_m: float

    def __post_init__(self) -> None:
        _check_radius(self.radius_m)

    def contains(self, x_m: Float64, y_m: Float64) -> Bool:
        """Mark the places (N,) in the circle."""
        return np.hypot(x_m - self.x_m, y_m - self.y_m) <= self.radius_m


@dataclass(frozen=True)
class Filters:
    """Restrictions that apply together; None restricts nothing.

    Attributes:
        scene: ids.
        traversal: ids.
        drive: ids.
        vehicle: pseudonyms.
        camera: names.
        light: day, dusk, night.
        weather: clear, clouds ...
        time: start (included) and end (excluded), Unix ns.
        within: circles; a place must lie in all of them.
        withheld: whether a published dataset withholds an image, or an image of a frame.
    """

    scene: frozenset[str] | None = None
    traversal: frozenset[str] | None = None
    drive: frozenset[str] | None = None
    vehicle: frozenset[str] | None = None
    camera: frozenset[str] | None = None
    light: frozenset[str] | None = None
    weather: frozenset[str] | None = None
    time: tuple[int, int] | None = None
    within: tuple[Circle | LocalCircle, ...] = ()
    withheld: frozenset[bool] | None = None

    def combined_with(self, other: Filters) -> Filters:
        """Return filters that require both these restrictions and others."""
        changes: dict[str, object] = {"within": self.within + other.within}
        for field in fields(self):
            ours, theirs = getattr(self, field.name), getattr(other, field.name)
            if field.name in ("time", "within") or theirs is None:
                continue
            changes[field.name] = theirs if ours is None else ours & theirs
        if self.time is not None and other.time is not None:
            changes["time"] = (max(self.time[0], other.time[0]), min(self.time[1], other.time[1]))
        elif other.time is not None:
            changes["time"] = other.time
        return replace(self, **changes)  # type: ignore[arg-type]

    def to_dict(self) -> dict[str, object]:
        """Return the restrictions as JSON values. Sets are sorted; fields without a restriction are left out."""
        plain: dict[str, object] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, frozenset):
                plain[field.name] = sorted(value)
            elif value:
                plain[field.name] = [asdict(circle) for circle in value] if field.name == "within" else list(value)
        return plain


def _check_radius(radius_m: float) -> None:
    if not 0.0 <= radius_m <= MAX_RADIUS_M:
        raise UsageError(
            f"radius {radius_m} m",
            place="within",
            expected=f"0 to {MAX_RADIUS_M:.0f} m",
            remedy="filter by scene for larger areas",
        )
