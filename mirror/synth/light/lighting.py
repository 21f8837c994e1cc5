"""What the renderer needs to know of a condition: sun, sky, lamps, air, and how cameras set themselves to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64, Records
from mirror.synth.light.atmosphere import clear_dome, dome_directions, dome_weights
from mirror.synth.light.clouds import PERIOD, cloud_field
from mirror.synth.light.condition import Condition, Weather
from mirror.synth.light.sky import sky
from mirror.synth.light.sun import season_of, sun_direction, sunlight
from mirror.synth.model import flat

LIGHTING: Final = np.dtype(
    [
        ("sun", np.float64, 3),
        ("sunlight", np.float64, 3),
        ("horizon", np.float64, 3),
        ("horizon_away", np.float64, 3),
        ("horizon_glow", np.float64, 3),
        ("sky_light", np.float64, 3),
        ("ground_light", np.float64, 3),
        ("cloud_lit", np.float64, 3),
        ("cloud_base", np.float64, 3),
        ("cloud_shift", np.float64, 2),
        ("cloud_wind", np.float64, 2),
        ("cloud", np.float64),
        ("lamp_light", np.float64, 3),
        ("headlight", np.float64),
        ("vehicle_lights", np.float64),
        ("lit_windows", np.float64),
        ("shadows", np.float64),
        ("dark", np.float64),
        ("wet", np.float64),
        ("haze_per_m", np.float64),
        ("season", np.float64),
        ("white", np.float64, 3),
        ("middle", np.float64),
        ("exposure", np.float64),
        ("read_noise", np.float64),
        ("shot_noise", np.float64),
    ]
)
"""One condition.

Light is in units of radiance of a white dull surface under it: a surface of reflectance ``f`` that faces the sun and
sees half the sky shows ``f * (sunlight + sky_light / 2 + ground_light / 2)``.

``sun``: direction; ``sunlight``: on a surface that faces it, 0 where it is hidden or has set; ``horizon``: mean
radiance of the sky just above it, ``horizon_away`` that opposite the sun, and ``horizon_glow`` what it has more towards
the sun: the colours of haze; ``sky_light``: on level ground; ``ground_light``: what the ground
sends back up; ``cloud_lit``, ``cloud_base``: radiance of clouds where the sun reaches them and where it does not;
``cloud_shift``: of the clouds, in heights of their layer, and ``cloud_wind`` its change a second; ``cloud``: share of
the sky that they cover; ``lamp_light``: below a street lamp; ``headlight``: strength of the recording vehicle's beams;
``vehicle_lights``: how much all vehicles' lamps burn, 0 to 1; ``lit_windows``: share of windows that are lit;
``shadows``: 1 where things keep the sun off each other; ``dark``: 0 by day, 1 at night; ``wet``: 1 in rain;
``haze_per_m``: extinction; ``season``: part of the year, of `season_of`; ``white``: gains of red, green and blue with
which cameras meet the light's colour; ``middle``: mean radiance of a street under this light; ``exposure``: gain that
suits that; ``read_noise``: standard deviation as a share of full scale, and ``shot_noise``: variance a unit of signal.
"""

_SUNLIGHT: Final = 2.5
_MIDSUMMER: Final = 0.5
_ELEVATIONS_DEG: Final = (-18.0, -12.0, -9.0, -6.0, -4.0, -2.5, 0.0, 5.0, 10.0, 20.0, 38.0, 60.0, 90.0)
# Light of a clear sky on level ground, as eyes that have grown used to the dark see it: the truth spans 10^8.
_SKY_LIGHT: Final = (0.006, 0.008, 0.013, 0.04, 0.08, 0.12, 0.19, 0.25, 0.29, 0.33, 0.38, 0.42, 0.44)
_NIGHT_ZENITH: Final = np.array([0.0035, 0.0045, 0.0080])
_NIGHT_HORIZON: Final = np.array([0.0260, 0.0190, 0.0140])
_COVER: Final[dict[Weather, float]] = {"clear": 0.27, "clouds": 1.0, "rain": 1.0}
_OVERCAST: Final[dict[Weather, float]] = {"clear": 0.0, "clouds": 1.55, "rain": 0.85}
_HAZE_PER_M: Final[dict[Weather, float]] = {"clear": 1 / 2400, "clouds": 1 / 1400, "rain": 1 / 420}
_WARM: Final = np.array([1.35, 0.95, 0.55])
_GREY: Final = np.array([0.95, 1.0, 1.06])
_GROUND: Final = np.array([0.16, 0.155, 0.14])
_LAMP: Final = np.array([1.25, 0.92, 0.55])
_ADAPTED: Final = 0.72
_MIDDLE: Final = 0.20
_REFLECTANCE: Final = 0.19
_AROUND: Final = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
_RING: Final = np.array([np.cos(_AROUND), np.sin(_AROUND)])
_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True, eq=False)
class Lighting:
    """Light and weather of a drive, for compiled kernels.

    Attributes:
        record: LIGHTING, one record; `flat` makes its fields single numbers.
        dome: (DOME, DOME, 3) radiance of the clear sky.
        clouds: the field of clouds, of `cloud_field`.
    """

    record: Records
    dome: Float32
    clouds: Float32

    def at(self, time_s: float) -> Records:
        """The record as it is so many seconds after the start: clouds have moved."""
        record = self.record.copy()
        record["cloud_shift"] += time_s * record["cloud_wind"]
        return record


def lighting(condition: Condition, longitude_deg: float, latitude_deg: float) -> Lighting:
    """Light and weather of a condition at a place; the sun stays where it is at the start."""
    effects, weather = condition.effects, condition.weather
    record = np.zeros(1, LIGHTING)[0]
    sun = sun_direction(condition.start_ns, longitude_deg, latitude_deg)
    elevation = float(np.degrees(np.arcsin(np.clip(sun[2], -1.0, 1.0))))
    azimuth = float(np.degrees(np.arctan2(sun[1], sun[0])))
    dark = float(np.clip((7.0 - elevation) / 15.0, 0.0, 1.0))
    record["sun"], record["dark"] = sun, dark
    record["shadows"] = float(effects.sun_shadows)
    record["cloud"] = _COVER[weather]
    dome = _dome(elevation, azimuth)
    _clouds(record, condition, elevation, dome)
    dome32 = dome.astype(np.float32)
    light, ring = _sums(record, dome32)
    record["sky_light"], record["horizon"] = light, ring.mean(axis=0)
    towards = sun[:2] / np.hypot(*sun[:2]) @ _RING
    record["horizon_away"] = ring[towards < -0.5].mean(axis=0)
    record["horizon_glow"] = ring[towards > 0.85].mean(axis=0) - record["horizon_away"]
    record["sunlight"] = _SUNLIGHT * sunlight(elevation) if weather == "clear" else 0.0
    record["ground_light"] = _GROUND * (light + max(float(sun[2]), 0.0) * record["sunlight"])
    record["lamp_light"] = _LAMP * float(np.clip(1.6 * dark - 0.5, 0.0, 1.0))
    record["lit_windows"] = 0.45 * float(np.clip(1.5 * dark - 0.4, 0.0, 1.0))
    burn = max(float(np.clip(2.0 * dark - 0.4, 0.0, 1.0)), 0.5 * (weather == "rain"))
    record["vehicle_lights"], record["headlight"] = burn, 1.3 * burn
    record["haze_per_m"] = _HAZE_PER_M[weather]
    record["season"] = season_of(condition.start_ns, latitude_deg) if effects.season else _MIDSUMMER
    record["wet"] = float(weather == "rain")
    _camera(record)
    # Only now: cameras are set to the whole of the light, so that a switch changes nothing but its own.
    record["lamp_light"] *= effects.lamps
    record["lit_windows"] *= effects.windows
    record["vehicle_lights"] *= effects.headlights
    record["headlight"] *= effects.headlights
    record["haze_per_m"] *= effects.haze
    record["wet"] *= effects.wet_road
    return Lighting(record, dome32, cloud_field())


def _dome(elevation: float, azimuth: float) -> Float64:
    """A clear sky at the brightness that eyes give it, and the night's beneath it."""
    clear = clear_dome(round(elevation, 2), round(azimuth, 2))
    light = float(_LUMINANCE @ np.einsum("ij,ijk->k", dome_weights(), clear))
    wanted = float(np.interp(elevation, _ELEVATIONS_DEG, _SKY_LIGHT))
    # Below -9 degrees only what is scattered many times is left: the night's own sky.
    share = float(np.clip((elevation + 9.0) / 3.0, 0.0, 1.0))
    up = dome_directions()[..., 2:]
    night = _NIGHT_HORIZON + (_NIGHT_ZENITH - _NIGHT_HORIZON) * np.sqrt(up)
    return night + (clear * (share * wanted / light) if share > 0.0 else 0.0)


def _clouds(record: Records, condition: Condition, elevation: float, dome: Float64) -> None:
    """Where clouds are at the start, and how bright."""
    rng = np.random.default_rng([condition.start_ns // 86_400_000_000_000, condition.visit])
    record["cloud_shift"] = rng.uniform(0.0, PERIOD, 2)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    record["cloud_wind"] = 0.004 * np.cos(heading), 0.004 * np.sin(heading)
    light = np.einsum("ij,ijk->k", dome_weights(), dome)
    if condition.weather == "clear":
        lit = 0.42 * _SUNLIGHT * sunlight(max(elevation, 3.0)) * float(np.clip((elevation + 4.0) / 10.0, 0.0, 1.0))
        # At night it is towns that light clouds, from below.
        own = (0.75 + 0.75 * _WARM * float(np.clip((-elevation - 6.0) / 6.0, 0.0, 1.0))) * light
        record["cloud_lit"], record["cloud_base"] = lit + own, 0.12 * lit + own
        return
    grey = float(_LUMINANCE @ light) * _OVERCAST[condition.weather] * _GREY
    # The last light of the day colours an overcast sky too.
    grey += 0.25 * _OVERCAST[condition.weather] * (light - float(_LUMINANCE @ light))
    spread = 0.17 if condition.weather == "clouds" else 0.12
    record["cloud_lit"], record["cloud_base"] = (1.0 + spread) * grey, (1.0 - spread) * grey


def _sums(record: Records, dome: Float32) -> tuple[Float64, Float64]:
    """Light of the whole sky on level ground, and its radiance (N, 3) just above the horizon all round."""
    flattened = record.reshape(1).view(flat(LIGHTING))[0]
    clouds, away, weights = cloud_field(), dome_directions(), dome_weights()
    light = np.zeros(3)
    for row, column in np.argwhere(weights > 0.0)[::3]:
        x, y, z = away[row, column]
        light += weights[row, column] * np.array(sky(dome, clouds, flattened, x, y, z, 0.02))
    light /= weights[weights > 0.0][::3].sum()
    ring = np.array([sky(dome, clouds, flattened, east, north, 0.02, 0.02) for east, north in _RING.T])
    return light, ring


def _camera(record: Records) -> None:
    """How cameras set themselves: gains against the light's colour, exposure, and the noise that comes of it."""
    dark = float(record["dark"])
    level = max(float(record["sun"][2]), 0.0) * record["sunlight"] + record["sky_light"]
    light = level + 0.30 * record["lamp_light"] + 0.02 * record["headlight"]
    luminance = float(_LUMINANCE @ light)
    gains = (luminance / light) ** _ADAPTED
    record["white"] = gains / (_LUMINANCE @ gains)
    record["middle"] = _REFLECTANCE * luminance
    record["exposure"] = _MIDDLE * (1.0 - 0.45 * dark) / record["middle"]
    record["read_noise"] = 0.0006 + 0.0030 * dark
    record["shot_noise"] = 3.5e-5 + 4.5e-4 * dark
