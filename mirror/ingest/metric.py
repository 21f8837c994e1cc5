"""Compiled distances on the surface that a track lives on: the WGS 84 ellipsoid, or the plane of a local frame.

A track's coordinates are ``first`` and ``second``: longitude and latitude in degrees, or x and y in metres.
"""

from __future__ import annotations

import math

from numba import njit

from mirror.geometry.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M

_RAD = math.pi / 180.0
_EARTH_M = 6_371_000.0


@njit(cache=True, nogil=True)
def scales(second: float, geodetic: bool) -> tuple[float, float]:
    """Metres per unit of the two coordinates at a place (exact first derivatives)."""
    if not geodetic:
        return 1.0, 1.0
    sin_lat = math.sin(second * _RAD)
    inner = 1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat
    normal = SEMI_MAJOR_M / math.sqrt(inner)
    return normal * math.cos(second * _RAD) * _RAD, normal * (1.0 - ECCENTRICITY_SQUARED) / inner * _RAD


@njit(cache=True, nogil=True)
def unwrap(difference: float, geodetic: bool) -> float:
    """A difference of first coordinates, the short way round the globe."""
    if geodetic:
        if difference > 180.0:
            return difference - 360.0
        if difference < -180.0:
            return difference + 360.0
    return difference


@njit(cache=True, nogil=True)
def step_m(first0: float, second0: float, first1: float, second1: float, geodetic: bool) -> float:
    """Length of one step of motion, by the metric at its middle: exact to 1e-8 of itself below 1 km."""
    scale_x, scale_y = scales(0.5 * (second0 + second1), geodetic)
    dx = unwrap(first1 - first0, geodetic) * scale_x
    dy = (second1 - second0) * scale_y
    return math.sqrt(dx * dx + dy * dy)


@njit(cache=True, nogil=True)
def distance_m(first: float, second: float, first0: float, second0: float, geodetic: bool) -> float:
    """Geodesic distance of nearby places: the chord in closed form, bent to the arc of the mean curvature.

    The compiled twin of `mirror.geometry.geodesy.surface_distance_m`; below 1e-7 m of error within 2 km. The chord is
    built from differences of sines, so that it keeps its digits when the places are close.
    """
    if not geodetic:
        return math.sqrt((first - first0) ** 2 + (second - second0) ** 2)
    lat, lat0 = second * _RAD, second0 * _RAD
    half_dlon = 0.5 * unwrap(first - first0, True) * _RAD
    sin_lat, cos_lat, sin_lat0, cos_lat0 = math.sin(lat), math.cos(lat), math.sin(lat0), math.cos(lat0)
    inner, inner0 = 1.0 - ECCENTRICITY_SQUARED * sin_lat**2, 1.0 - ECCENTRICITY_SQUARED * sin_lat0**2
    normal, normal0 = SEMI_MAJOR_M / math.sqrt(inner), SEMI_MAJOR_M / math.sqrt(inner0)
    # p = N cos(lat) is the distance from the axis: chord^2 = (p - p0)^2 + 4 p p0 sin^2(dlon / 2) + (z - z0)^2
    across, across0 = normal * cos_lat, normal0 * cos_lat0
    dz = (1.0 - ECCENTRICITY_SQUARED) * (normal * sin_lat - normal0 * sin_lat0)
    chord2 = (across - across0) ** 2 + 4.0 * across * across0 * math.sin(half_dlon) ** 2 + dz * dz
    radius = SEMI_MAJOR_M * math.sqrt(1.0 - ECCENTRICITY_SQUARED) / inner0
    return 2.0 * radius * math.asin(min(math.sqrt(chord2) / (2.0 * radius), 1.0))


@njit(cache=True, nogil=True)
def plane_error(second: float, radius: float, geodetic: bool) -> float:
    """Bound of the relative error of distances up to a radius, measured by the metric at the centre."""
    if not geodetic:
        return 1e-12
    return 4.0 * radius / _EARTH_M * (1.0 + abs(math.tan(second * _RAD))) + 1e-6
