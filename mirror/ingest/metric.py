"""Compiled distances on the surface of a track: the WGS 84 ellipsoid, or the plane of a local metric frame.

Coordinates are ``lon_or_x`` and ``lat_or_y``: longitude and latitude in degrees if ``geodetic``, else x and y in
metres. All functions take one place at a time.
"""

from __future__ import annotations

import math

from mirror.compiled import compiled_above, inner_njit
from mirror.geometry.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M

_RAD_PER_DEG = math.pi / 180.0
_EARTH_M = 6_371_000.0
PLAIN_ELEMENTS = 100_000
"""Elements of arrays below which the functions of the trigger run as plain Python: some ten thousand fixes, which take
about as long as the compilation of a function."""


@compiled_above(PLAIN_ELEMENTS)
def scales(lat_or_y: float, geodetic: bool) -> tuple[float, float]:
    """Return metres per unit of longitude (or x) and of latitude (or y) at a latitude, as exact derivatives."""
    if not geodetic:
        return 1.0, 1.0
    sin_lat = math.sin(lat_or_y * _RAD_PER_DEG)
    inner = 1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat
    normal = SEMI_MAJOR_M / math.sqrt(inner)
    north_m = normal * (1.0 - ECCENTRICITY_SQUARED) / inner
    return normal * math.cos(lat_or_y * _RAD_PER_DEG) * _RAD_PER_DEG, north_m * _RAD_PER_DEG


@compiled_above(PLAIN_ELEMENTS)
def unwrap(difference: float, geodetic: bool) -> float:
    """Wrap a difference of longitudes to the short way round the globe; return a difference of x unchanged."""
    if geodetic:
        if difference > 180.0:
            return difference - 360.0
        if difference < -180.0:
            return difference + 360.0
    return difference


@compiled_above(PLAIN_ELEMENTS)
def step_m(lon_or_x0: float, lat_or_y0: float, lon_or_x1: float, lat_or_y1: float, geodetic: bool) -> float:
    """Return the length of a step in metres, with the scales at its middle latitude.

    The relative error is below 1e-8 up to 1 km.
    """
    scale_x, scale_y = scales(0.5 * (lat_or_y0 + lat_or_y1), geodetic)
    dx = unwrap(lon_or_x1 - lon_or_x0, geodetic) * scale_x
    dy = (lat_or_y1 - lat_or_y0) * scale_y
    return math.sqrt(dx * dx + dy * dy)


@compiled_above(PLAIN_ELEMENTS)
def distance_m(lon_or_x: float, lat_or_y: float, lon_or_x0: float, lat_or_y0: float, geodetic: bool) -> float:
    """Return the geodesic distance in metres between nearby places.

    The chord is computed in closed form, and then the arc over it on a circle of the mean curvature. The error is below
    1e-7 m within 2 km. This is the compiled form of `mirror.geometry.geodesy.surface_distance_m`. The chord is built
    from differences of sines, which keeps its precision when the places are close.
    """
    if not geodetic:
        dx, dy = lon_or_x - lon_or_x0, lat_or_y - lat_or_y0
        return math.sqrt(dx * dx + dy * dy)
    lat, lat0 = lat_or_y * _RAD_PER_DEG, lat_or_y0 * _RAD_PER_DEG
    half_dlon = 0.5 * unwrap(lon_or_x - lon_or_x0, True) * _RAD_PER_DEG
    sin_lat, cos_lat, sin_lat0, cos_lat0 = math.sin(lat), math.cos(lat), math.sin(lat0), math.cos(lat0)
    inner, inner0 = 1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat, 1.0 - ECCENTRICITY_SQUARED * sin_lat0 * sin_lat0
    normal, normal0 = SEMI_MAJOR_M / math.sqrt(inner), SEMI_MAJOR_M / math.sqrt(inner0)
    # p = N cos(lat) is the distance from the axis: chord^2 = (p - p0)^2 + 4 p p0 sin^2(dlon / 2) + (z - z0)^2
    axis_m, axis_m0 = normal * cos_lat, normal0 * cos_lat0
    dz = (1.0 - ECCENTRICITY_SQUARED) * (normal * sin_lat - normal0 * sin_lat0)
    d_axis_m, sin_half = axis_m - axis_m0, math.sin(half_dlon)
    chord2 = d_axis_m * d_axis_m + 4.0 * axis_m * axis_m0 * (sin_half * sin_half) + dz * dz
    radius = SEMI_MAJOR_M * math.sqrt(1.0 - ECCENTRICITY_SQUARED) / inner0
    return 2.0 * radius * math.asin(min(math.sqrt(chord2) / (2.0 * radius), 1.0))


@inner_njit
def plane_error(lat_or_y: float, radius: float, geodetic: bool) -> float:
    """Return a bound of the relative error of distances within a radius (m), with the scales at the centre."""
    if not geodetic:
        return 1e-12
    return 4.0 * radius / _EARTH_M * (1.0 + abs(math.tan(lat_or_y * _RAD_PER_DEG))) + 1e-6
