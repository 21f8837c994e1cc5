"""Day, dusk or night, from the elevation of the sun."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64

Light = Literal["day", "dusk", "night"]

# Civil twilight ends, by definition, with the sun's centre 6 degrees below the horizon.
CIVIL_TWILIGHT_DEG: Final = -6.0

_J2000_NS: Final = 946_728_000_000_000_000
_DAY_NS: Final = 86_400_000_000_000
# Terrestrial time is 69 s ahead of UTC in this decade; a minute more or less moves the sun by 0.0007 degrees.
_TERRESTRIAL_DAYS: Final = 69.0 / 86_400.0


def solar_elevation_deg(
    timestamp_ns: npt.ArrayLike, longitude_deg: npt.ArrayLike, latitude_deg: npt.ArrayLike
) -> Float64:
    """Return the elevation of the sun's centre above the horizon, without refraction.

    The result is within 0.015 degrees of the precise ephemeris from 1970 to 2100. Source: J. Meeus, Astronomical
    Algorithms, 2nd ed., chapters 12, 22 and 25, the low-accuracy formulas of the NOAA solar calculator.

    Args:
        timestamp_ns: (...,) Unix time, UTC.
        longitude_deg: (...,) WGS 84.
        latitude_deg: (...,) WGS 84.

    Returns:
        (...,) degrees in [-90, 90]; NaN where longitude or latitude is not finite.
    """
    days = (np.asarray(timestamp_ns, np.int64) - _J2000_NS) / _DAY_NS
    century = (days + _TERRESTRIAL_DAYS) / 36_525.0
    mean_longitude = 280.46646 + century * (36_000.76983 + century * 0.0003032)
    anomaly = np.radians(357.52911 + century * (35_999.05029 - century * 0.0001537))
    centre = (
        (1.914602 - century * (0.004817 + century * 0.000014)) * np.sin(anomaly)
        + (0.019993 - century * 0.000101) * np.sin(2 * anomaly)
        + 0.000289 * np.sin(3 * anomaly)
    )
    node = np.radians(125.04 - 1934.136 * century)
    nutation = -0.00478 * np.sin(node)
    # Aberration subtracts 0.00569 degrees.
    longitude = np.radians(mean_longitude + centre - 0.00569 + nutation)
    obliquity = np.radians(23.4392911 - century * 0.0130042 + 0.00256 * np.cos(node))
    ascension = np.arctan2(np.cos(obliquity) * np.sin(longitude), np.cos(longitude))
    declination = np.arcsin(np.sin(obliquity) * np.sin(longitude))
    sidereal = 280.46061837 + 360.98564736629 * days + 0.000387933 * century**2 + nutation * np.cos(obliquity)
    hour_angle = np.radians(sidereal + np.asarray(longitude_deg, np.float64)) - ascension
    lat = np.radians(np.asarray(latitude_deg, np.float64))
    sine = np.sin(lat) * np.sin(declination) + np.cos(lat) * np.cos(declination) * np.cos(hour_angle)
    return np.asarray(np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))))


def light_label(elevation_deg: float) -> Light:
    """Label a solar elevation.

    ``day``: the sun's centre is on or above the horizon; ``dusk``: civil twilight of the evening or the morning;
    ``night``: the sun's centre is 6 degrees below the horizon or lower.

    Args:
        elevation_deg: finite, without refraction.
    """
    if elevation_deg >= 0.0:
        return "day"
    return "dusk" if elevation_deg > CIVIL_TWILIGHT_DEG else "night"
