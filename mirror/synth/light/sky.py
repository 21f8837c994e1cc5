"""Radiance of the sky in a direction: clear sky, the sun, clouds."""

from __future__ import annotations

import math
from typing import Final

from mirror.arrays import Float32, Records
from mirror.compiled import inner_per_pixel, per_pixel
from mirror.portable import scalars
from mirror.synth.light.clouds import LEVELS, PERIOD, SIDE

# The cloud layer curves down to the horizon: in a level direction its distance is 1 / _BEND heights.
_BEND: Final = 0.11
# Below this height, interpolation would use samples of the dome from below the horizon.
_LOWEST: Final = 0.035
_EDGE: Final = 0.16
_DETAIL: Final = 7.3
_DETAIL_SHARE: Final = 0.07
_TOWARDS_SUN: Final = 0.045
_DISC_COSINE: Final = scalars.cos(math.radians(0.40))
_RIM_COSINE: Final = scalars.cos(math.radians(0.22))
_DISC: Final = 30.0
_SUN_IS_CLEAR: Final = 70.0


@inner_per_pixel()
def _cloud(clouds: Float32, x: float, y: float, start: int, side: int) -> float:
    """Bilinear interpolation of one level of the densities; the position is in samples."""
    i, j = math.floor(y), math.floor(x)
    u, v = x - j, y - i
    mask = side - 1
    row, column = int(i) & mask, int(j) & mask
    below, right = ((row + 1) & mask) * side + start, (column + 1) & mask
    row = row * side + start
    above = clouds[row + column] * (1.0 - u) + clouds[row + right] * u
    return above * (1.0 - v) + (clouds[below + column] * (1.0 - u) + clouds[below + right] * u) * v


@per_pixel()
def sky(
    dome: Float32, clouds: Float32, setting: Records, dx: float, dy: float, dz: float, spread: float
) -> tuple[float, float, float]:
    """Compute the radiance of the sky in a direction: red, green, blue.

    Args:
        dome: radiance of the clear sky, from `Lighting`.
        clouds: densities of the clouds, from `Lighting`.
        setting: LIGHTING, flat.
        dx: unit direction, east component.
        dy: unit direction, north component.
        dz: unit direction, up component; below the horizon the result is the sky at the horizon.
        spread: angular width of the footprint, radians.
    """
    up = max(dz, 0.0)
    half = 0.5 * (dome.shape[0] - 1)
    scale = half / (1.0 + up)
    if dz < _LOWEST:
        scale = half * math.sqrt((1.0 - _LOWEST) / ((1.0 + _LOWEST) * max(dx * dx + dy * dy, 1e-12)))
    x, y = half + dx * scale, half + dy * scale
    j, i = int(x), int(y)
    u, v = x - j, y - i
    a, b, c, d = (1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v
    red = a * dome[i, j, 0] + b * dome[i, j + 1, 0] + c * dome[i + 1, j, 0] + d * dome[i + 1, j + 1, 0]
    green = a * dome[i, j, 1] + b * dome[i, j + 1, 1] + c * dome[i + 1, j, 1] + d * dome[i + 1, j + 1, 1]
    blue = a * dome[i, j, 2] + b * dome[i, j + 1, 2] + c * dome[i + 1, j, 2] + d * dome[i + 1, j + 1, 2]
    facing = dx * setting.sun_0 + dy * setting.sun_1 + dz * setting.sun_2
    if facing > _DISC_COSINE and setting.sunlight_0 > 0.0:
        disc = _DISC * min((facing - _DISC_COSINE) / (_RIM_COSINE - _DISC_COSINE), 1.0)
        red, green, blue = (
            red + disc * setting.sunlight_0,
            green + disc * setting.sunlight_1,
            blue + disc * setting.sunlight_2,
        )
    # The inverse of the distance to the layer, in heights of the layer.
    near = up + _BEND
    finest = SIDE / PERIOD
    blurred = spread * finest / (near * near)
    start, side, level = 0, SIDE, 0
    while blurred > 1.4 and level < LEVELS - 1:
        start, side, level, blurred = start + side * side, side // 2, level + 1, 0.5 * blurred
    scale = side / PERIOD
    px, py = dx / near + setting.cloud_shift_0, dy / near + setting.cloud_shift_1
    density = _cloud(clouds, px * scale, py * scale, start, side)
    if level < 2:
        fine = _cloud(clouds, px * scale * _DETAIL, py * scale * _DETAIL, start, side) - 0.5
        density += _DETAIL_SHARE * fine
    cover = (density - 1.0 + setting.cloud) / _EDGE + 0.5
    if cover <= 0.0:
        return red, green, blue
    cover = min(cover, 1.0)
    cover = cover * cover * (3.0 - 2.0 * cover)
    if setting.cloud < 1.0:
        # Haze hides the clouds near the horizon.
        cover *= min(up * 9.0, 1.0) * 0.93
        # No cloud covers the sun while the street is sunlit.
        cover *= min(_SUN_IS_CLEAR * (1.0 - facing), 1.0) if setting.sunlight_0 > 0.0 else 1.0
        ahead = _cloud(
            clouds,
            (px + _TOWARDS_SUN * setting.sun_0) * scale,
            (py + _TOWARDS_SUN * setting.sun_1) * scale,
            start,
            side,
        )
        cloud_brightness = (
            0.62 + 2.6 * (density - ahead) - 0.35 * cover * (density - 1.0 + setting.cloud) / setting.cloud
        )
        # Thin edges near the sun are bright.
        glow = max(facing, 0.0)
        cloud_brightness += 0.5 * glow * glow * glow * glow * (1.0 - cover)
        cloud_brightness = min(max(cloud_brightness, 0.0), 1.3)
    else:
        cover, cloud_brightness = 1.0, 0.5 + 1.1 * (density - 0.5) * min(0.35 + up, 1.0) + 0.35 * (up - 0.5)
    red += cover * (setting.cloud_base_0 + cloud_brightness * (setting.cloud_lit_0 - setting.cloud_base_0) - red)
    green += cover * (setting.cloud_base_1 + cloud_brightness * (setting.cloud_lit_1 - setting.cloud_base_1) - green)
    blue += cover * (setting.cloud_base_2 + cloud_brightness * (setting.cloud_lit_2 - setting.cloud_base_2) - blue)
    return red, green, blue
