"""The lighting record of a condition: sun, sky, lamps, haze, and the settings of the cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64, Records
from mirror.portable import arrays
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
"""The lighting of one condition.

The unit of light is the radiance of a white diffuse surface under it: a surface of reflectance ``f`` that faces the sun
and half the sky has the radiance ``f * (sunlight + sky_light / 2 + ground_light / 2)``.

- ``sun``: unit direction to the sun; ``sunlight``: light of the sun on a surface that faces it, 0 if clouds hide the
  sun or it has set.
- ``horizon``: mean radiance of the sky just above the horizon; ``horizon_away``: the same opposite the sun;
  ``horizon_glow``: its increase towards the sun. They give the colour of haze.
- ``sky_light``: light of the sky on level ground; ``ground_light``: light that the ground reflects upwards.
- ``cloud_lit``, ``cloud_base``: radiance of sunlit and of shaded clouds; ``cloud_shift``: displacement of the clouds,
  in heights of their layer; ``cloud_wind``: its change per second; ``cloud``: share of the sky that clouds cover.
- ``lamp_light``: light below a street lamp; ``headlight``: strength of the recording vehicle's headlights;
  ``vehicle_lights``: brightness of all vehicles' lamps, 0 to 1; ``lit_windows``: share of windows that are lit.
- ``shadows``: 1 if the sun casts shadows; ``dark``: 0 by day, 1 at night; ``wet``: 1 in rain; ``haze_per_m``:
  extinction; ``season``: fraction of the year, from `season_of`.
- ``white``: white balance gains of red, green and blue; ``middle``: mean radiance of a street in this light;
  ``exposure``: the matching gain; ``read_noise``: standard deviation as a share of full scale; ``shot_noise``: variance
  per unit of signal.
"""

_SUNLIGHT: Final = 2.5
_MIDSUMMER: Final = 0.5
_ELEVATIONS_DEG: Final = (-18.0, -12.0, -9.0, -6.0, -4.0, -2.5, 0.0, 5.0, 10.0, 20.0, 38.0, 60.0, 90.0)
# Light of a clear sky on level ground, as perceived by eyes adapted to the dark; the physical range is 10^8.
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
_RING: Final = np.array([arrays.cos(_AROUND), arrays.sin(_AROUND)])
_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True, eq=False)
class Lighting:
    """Light and weather of a drive, for compiled kernels.

    Attributes:
        record: one LIGHTING record; `flat` gives its fields as single numbers.
        dome: (DOME, DOME, 3) radiance of the clear sky.
        clouds: densities of the clouds, from `cloud_field`.
    """

    record: Records
    dome: Float32
    clouds: Float32

    def at(self, time_s: float) -> Records:
        """Return the light ``time_s`` seconds after the start, with clouds moved by the wind."""
        record = self.record.copy()
        record["cloud_shift"] += time_s * record["cloud_wind"]
        return record


def compute_lighting(condition: Condition, longitude_deg: float, latitude_deg: float) -> Lighting:
    """Compute the lighting of a condition at a place, with the sun fixed at its position at the start."""
    effects, weather = condition.effects, condition.weather
    record = np.zeros(1, LIGHTING)[0]
    sun = sun_direction(condition.start_ns, longitude_deg, latitude_deg)
    elevation = float(np.degrees(arrays.arcsin(np.clip(sun[2], -1.0, 1.0))))
    azimuth = float(np.degrees(arrays.arctan2(sun[1], sun[0])))
    dark = float(np.clip((7.0 - elevation) / 15.0, 0.0, 1.0))
    record["sun"], record["dark"] = sun, dark
    record["shadows"] = float(effects.sun_shadows)
    record["cloud"] = _COVER[weather]
    dome = _dome(elevation, azimuth)
    _clouds(record, condition, elevation, dome)
    dome32 = dome.astype(np.float32)
    light, ring = _sums(record, dome32)
    record["sky_light"], record["horizon"] = light, ring.mean(axis=0)
    towards = arrays.matmul(sun[:2] / arrays.hypot(*sun[:2]), _RING)
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
    # Effects are switched off after the cameras are set, so that a switch does not change the exposure.
    record["lamp_light"] *= effects.lamps
    record["lit_windows"] *= effects.windows
    record["vehicle_lights"] *= effects.headlights
    record["headlight"] *= effects.headlights
    record["haze_per_m"] *= effects.haze
    record["wet"] *= effects.wet_road
    return Lighting(record, dome32, cloud_field())


def _dome(elevation: float, azimuth: float) -> Float64:
    """Radiance of a clear sky at its perceived brightness, plus the night sky."""
    clear = clear_dome(round(elevation, 2), round(azimuth, 2))
    light = float(arrays.matmul(_LUMINANCE, np.einsum("ij,ijk->k", dome_weights(), clear)))
    target = float(np.interp(elevation, _ELEVATIONS_DEG, _SKY_LIGHT))
    # Below -9 degrees single scattering gives no light; only the night sky is left.
    share = float(np.clip((elevation + 9.0) / 3.0, 0.0, 1.0))
    up = dome_directions()[..., 2:]
    night = _NIGHT_HORIZON + (_NIGHT_ZENITH - _NIGHT_HORIZON) * np.sqrt(up)
    return night + (clear * (share * target / light) if share > 0.0 else 0.0)


def _clouds(record: Records, condition: Condition, elevation: float, dome: Float64) -> None:
    """Set the position and the radiance of the clouds at the start."""
    rng = np.random.default_rng([condition.start_ns // 86_400_000_000_000, condition.visit])
    record["cloud_shift"] = rng.uniform(0.0, PERIOD, 2)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    record["cloud_wind"] = 0.004 * arrays.cos(heading), 0.004 * arrays.sin(heading)
    light = np.einsum("ij,ijk->k", dome_weights(), dome)
    if condition.weather == "clear":
        cloud_light = (
            0.42 * _SUNLIGHT * sunlight(max(elevation, 3.0)) * float(np.clip((elevation + 4.0) / 10.0, 0.0, 1.0))
        )
        # At night the lights of towns illuminate clouds from below.
        town_glow = (0.75 + 0.75 * _WARM * float(np.clip((-elevation - 6.0) / 6.0, 0.0, 1.0))) * light
        record["cloud_lit"], record["cloud_base"] = cloud_light + town_glow, 0.12 * cloud_light + town_glow
        return
    grey = float(arrays.matmul(_LUMINANCE, light)) * _OVERCAST[condition.weather] * _GREY
    # Twilight also colours an overcast sky.
    grey += 0.25 * _OVERCAST[condition.weather] * (light - float(arrays.matmul(_LUMINANCE, light)))
    spread = 0.17 if condition.weather == "clouds" else 0.12
    record["cloud_lit"], record["cloud_base"] = (1.0 + spread) * grey, (1.0 - spread) * grey


def _sums(record: Records, dome: Float32) -> tuple[Float64, Float64]:
    """Light of the whole sky on level ground, and its radiance (N, 3) just above the horizon in all directions."""
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
    """Set the camera fields: white balance, exposure and noise."""
    dark = float(record["dark"])
    level = max(float(record["sun"][2]), 0.0) * record["sunlight"] + record["sky_light"]
    light = level + 0.30 * record["lamp_light"] + 0.02 * record["headlight"]
    luminance = float(arrays.matmul(_LUMINANCE, light))
    gains = arrays.power(luminance / light, _ADAPTED)
    record["white"] = gains / (arrays.matmul(_LUMINANCE, gains))
    record["middle"] = _REFLECTANCE * luminance
    record["exposure"] = _MIDDLE * (1.0 - 0.45 * dark) / record["middle"]
    record["read_noise"] = 0.0006 + 0.0030 * dark
    record["shot_noise"] = 3.5e-5 + 4.5e-4 * dark
