"""Light and weather of a drive: where the sun stands, and what that makes of sky, lamps and windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64, Int64, Records
from mirror.recordings.light import Light, solar_elevation_deg

Weather = Literal["clear", "clouds", "rain"]

SUN_ELEVATION_DEG: Final[dict[Light, float]] = {"day": 38.0, "dusk": -2.5, "night": -25.0}
"""Elevations that are aimed at; in the winter of high latitudes the day's highest, if that is less."""

LIGHTING: Final = np.dtype(
    [
        ("sun", np.float64, 3),
        ("sunlight", np.float64, 3),
        ("zenith", np.float64, 3),
        ("horizon", np.float64, 3),
        ("sky_light", np.float64, 3),
        ("ground_light", np.float64, 3),
        ("lamp_light", np.float64, 3),
        ("headlight", np.float64),
        ("lit_windows", np.float64),
        ("dark", np.float64),
        ("wet", np.float64),
        ("cloud", np.float64),
        ("haze_per_m", np.float64),
        ("exposure", np.float64),
        ("noise", np.float64),
        ("season", np.float64),
    ]
)


@dataclass(frozen=True)
class Condition:
    """When a drive takes place and in what weather."""

    start_ns: int
    light: Light
    weather: Weather


def sun_direction(timestamp_ns: npt.ArrayLike, longitude_deg: float, latitude_deg: float) -> Float64:
    """Directions (..., 3) from a place to the sun: east, north, up; without refraction.

    East and north of a place are up elsewhere: 90 degrees on along the equator, and along the meridian.
    """
    stamps = np.asarray(timestamp_ns, np.int64)
    ups = ((longitude_deg + 90.0, 0.0), (longitude_deg, latitude_deg + 90.0), (longitude_deg, latitude_deg))
    return np.stack([np.sin(np.radians(solar_elevation_deg(stamps, *up))) for up in ups], axis=-1)


def instant_of(date: str, light: Light, longitude_deg: float, latitude_deg: float, *, morning: bool = False) -> int:
    """The minute of a local date at which the sun stands as the light asks.

    Args:
        date: ISO date, by the mean solar time of the place.
        light: day, dusk or night.
        longitude_deg: of the place.
        latitude_deg: of the place.
        morning: before noon instead of after it.

    Returns:
        Unix time in nanoseconds.
    """
    minute_ns = 60_000_000_000
    midnight = int(np.datetime64(date, "ns").astype(np.int64)) - round(longitude_deg / 15.0 * 60) * minute_ns
    minutes: Int64 = midnight + np.arange(0 if morning else 720, 720 if morning else 1440, dtype=np.int64) * minute_ns
    elevation = solar_elevation_deg(minutes, longitude_deg, latitude_deg)
    return int(minutes[np.argmin(np.abs(elevation - SUN_ELEVATION_DEG[light]))])


def lighting(condition: Condition, longitude_deg: float, latitude_deg: float) -> Records:
    """What the renderer needs to know of a condition: one LIGHTING record, the sun as it stands at the start."""
    look = np.zeros(1, LIGHTING)[0]
    look["sun"] = sun_direction(condition.start_ns, longitude_deg, latitude_deg)
    height = float(look["sun"][2])
    dark = float(np.clip(0.55 - 3.2 * height, 0.0, 1.0)) if height < 0.17 else 0.0
    cloud = {"clear": 0.25, "clouds": 0.75, "rain": 1.0}[condition.weather]
    look["dark"], look["cloud"], look["wet"] = dark, cloud, float(condition.weather == "rain")
    day = np.array([[0.16, 0.33, 0.72], [0.62, 0.74, 0.90], [0.36, 0.44, 0.60], [0.22, 0.20, 0.17]])
    overcast = np.array([[0.50, 0.54, 0.58], [0.66, 0.68, 0.70], [0.52, 0.54, 0.57], [0.14, 0.14, 0.14]])
    dusk = np.array([[0.07, 0.11, 0.26], [0.62, 0.36, 0.26], [0.16, 0.17, 0.25], [0.05, 0.04, 0.05]])
    night = np.array([[0.004, 0.006, 0.014], [0.030, 0.026, 0.030], [0.012, 0.014, 0.022], [0.006, 0.005, 0.005]])
    bright = day + (overcast - day) * (0.9 * cloud if cloud > 0.5 else 0.0)
    if condition.weather == "rain":
        bright = bright * 0.62
        dusk = 0.5 * dusk + 0.12 * overcast
    low = dusk + (night - dusk) * np.clip((-height - 0.03) / 0.15, 0.0, 1.0)
    blend = np.clip((height + 0.02) / 0.2, 0.0, 1.0)
    look["zenith"], look["horizon"], look["sky_light"], look["ground_light"] = low + (bright - low) * blend
    warm = np.clip(height / 0.5, 0.0, 1.0)
    shown = {"clear": 1.0, "clouds": 0.25, "rain": 0.0}[condition.weather]
    look["sunlight"] = (
        np.array([2.30, 1.90 + 0.22 * warm, 1.25 + 0.60 * warm]) * shown * np.clip(height / 0.12, 0.0, 1.0)
    )
    look["lamp_light"] = np.array([1.0, 0.74, 0.42]) * 1.1 * np.clip(dark * 1.6 - 0.5, 0.0, 1.0)
    look["headlight"] = 1.3 if dark > 0.3 else 0.0
    look["lit_windows"] = 0.45 * np.clip(dark * 1.5 - 0.4, 0.0, 1.0)
    look["haze_per_m"] = 1 / 380 if condition.weather == "rain" else 1 / 1500
    look["exposure"] = (2.5 if condition.weather == "rain" else 2.1) + 1.1 * dark
    look["noise"] = 0.008 + 0.022 * dark
    month = np.datetime64(condition.start_ns, "ns").astype("datetime64[M]").astype(int) % 12
    look["season"] = {9: 0.6, 10: 1.0, 11: 0.8}.get(int(month), 0.0)
    return look
