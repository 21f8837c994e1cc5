"""The position of the sun, its light on the ground, and the season."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64, Int64
from mirror.portable import arrays
from mirror.recordings.light import Light, solar_elevation_deg

SUN_ELEVATION_DEG: Final[dict[Light, float]] = {"day": 38.0, "dusk": -2.5, "night": -25.0}
"""Target elevations of the sun; in winter at high latitudes the highest of the day, if that is lower."""

# Vertical optical depths at 612, 549 and 465 nm: Rayleigh scattering of a standard atmosphere, and haze of clear air.
_RAYLEIGH: Final = np.array([0.0640, 0.0992, 0.1950])
_HAZE: Final = np.array([0.072, 0.083, 0.103])
# The elevation of the sun at which its light is white.
_BALANCED_AT_DEG: Final = 45.0
_DISC_RAD: Final = 0.0093
_YEAR_DAYS: Final = 365.2425


def sun_direction(timestamp_ns: npt.ArrayLike, longitude_deg: float, latitude_deg: float) -> Float64:
    """Return unit directions (..., 3) from a place to the sun: east, north, up; without refraction.

    The east axis of a place is the vertical of the point 90 degrees to the east on the equator, and the north axis is
    the vertical of the point 90 degrees to the north on the meridian, so three solar elevations give the direction.
    """
    stamps = np.asarray(timestamp_ns, np.int64)
    ups = ((longitude_deg + 90.0, 0.0), (longitude_deg, latitude_deg + 90.0), (longitude_deg, latitude_deg))
    return np.stack([arrays.sin(np.radians(solar_elevation_deg(stamps, *up))) for up in ups], axis=-1)


def instant_of(date: str, light: Light, longitude_deg: float, latitude_deg: float, *, morning: bool = False) -> int:
    """Find the minute of a local date at which the sun's elevation is closest to the elevation of a light.

    Args:
        date: ISO date, in the mean solar time of the place.
        light: day, dusk or night.
        longitude_deg: longitude of the place.
        latitude_deg: latitude of the place.
        morning: True: search before noon; False: after noon.

    Returns:
        Unix time in nanoseconds.
    """
    minute_ns = 60_000_000_000
    midnight = int(np.datetime64(date, "ns").astype(np.int64)) - round(longitude_deg / 15.0 * 60) * minute_ns
    minutes: Int64 = midnight + np.arange(0 if morning else 720, 720 if morning else 1440, dtype=np.int64) * minute_ns
    elevation = solar_elevation_deg(minutes, longitude_deg, latitude_deg)
    return int(minutes[np.argmin(np.abs(elevation - SUN_ELEVATION_DEG[light]))])


def season_of(timestamp_ns: int, latitude_deg: float) -> float:
    """Return the elapsed fraction of the year in [0, 1), from 1 January in the north and from 1 July in the south."""
    day = np.datetime64(timestamp_ns, "ns").astype("datetime64[D]")
    passed = int((day - day.astype("datetime64[Y]").astype("datetime64[D]")).astype(np.int64)) / _YEAR_DAYS
    return (passed + (0.5 if latitude_deg < 0.0 else 0.0)) % 1.0


def air_mass(elevation_deg: float) -> float:
    """Return the relative air mass towards the sun (F. Kasten, A. Young, Applied Optics 28, 1989)."""
    above = max(elevation_deg, 0.0)
    return 1.0 / (arrays.sin(np.radians(above)) + 0.50572 * arrays.power(above + 6.07995, -1.6364))


def sunlight(elevation_deg: float) -> Float64:
    """Return the sun's light on a surface that faces it: (3,) red, green, blue, relative to a sun at 45 degrees.

    The light fades over half a degree while the disc sets.
    """
    depth = _RAYLEIGH + _HAZE
    through: Float64 = arrays.exp(-depth * (air_mass(elevation_deg) - air_mass(_BALANCED_AT_DEG)))
    return through * float(np.clip(0.5 + np.radians(elevation_deg) / _DISC_RAD, 0.0, 1.0))
