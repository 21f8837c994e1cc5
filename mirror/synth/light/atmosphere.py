"""The radiance of a clear sky: single scattering of sunlight by air and haze around a spherical earth.

Follows T. Nishita and others, Display of the earth taking into account atmospheric scattering, SIGGRAPH 1993, with
ozone, which makes the zenith blue at dusk. The sun may be below the horizon.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays

DOME: Final = 96
"""Samples along a side of a dome: a square around the zenith in stereographic projection; the horizon is the inscribed
circle."""

_EARTH_M: Final = 6_371e3
_TOP_M: Final = 6_431e3
_AIR_M: Final = 8_000.0
_HAZE_M: Final = 1_200.0
_OZONE_M: Final = 25_000.0
_OZONE_HALF_M: Final = 15_000.0
# Scattering per metre at sea level, and absorption of ozone per metre at its densest, at the mean wavelengths of a
# display's red, green and blue: 612, 549 and 465 nm.
_AIR: Final = np.array([8.7e-6, 13.6e-6, 26.5e-6])
_HAZE: Final = np.array([7.2e-6, 7.6e-6, 8.3e-6])
_OZONE: Final = np.array([2.3e-6, 1.7e-6, 0.12e-6])
_HAZE_TAKES: Final = 1.1
_FORWARD: Final = 0.74
_VIEW_STEPS: Final = 18
_SUN_STEPS: Final = 16
_NO_LIGHT: Final = 1e3
# Share of the sky's light that the air scatters a second time, evenly in all directions.
_AGAIN: Final = 0.6


@lru_cache(maxsize=16)
def clear_dome(elevation_deg: float, azimuth_deg: float) -> Float64:
    """Compute the radiance (DOME, DOME, 3) of a clear sky, in units of the sunlight above the atmosphere.

    Args:
        elevation_deg: elevation of the sun.
        azimuth_deg: azimuth of the sun, counter-clockwise from east.

    Returns:
        The dome, read-only; rows increase to the north, columns to the east.
    """
    away = dome_directions().reshape(-1, 3)
    up, aside = np.radians(elevation_deg), np.radians(azimuth_deg)
    sun = np.array([arrays.cos(up) * arrays.cos(aside), arrays.cos(up) * arrays.sin(aside), arrays.sin(up)])
    eye = np.array([0.0, 0.0, _EARTH_M + 10.0])
    reach = distance_to_sphere(np.broadcast_to(eye, away.shape), away, _TOP_M)
    # Steps grow with distance, because most of the light near the horizon comes from nearby air.
    edges = arrays.power(np.linspace(0.0, 1.0, _VIEW_STEPS + 1), 2.5)
    cosine = arrays.matmul(away, sun)
    air_phase = 3.0 / (16.0 * np.pi) * (1.0 + cosine**2)
    square = _FORWARD**2
    haze_phase = (
        3.0 / (8.0 * np.pi) * (1.0 - square) * (1.0 + cosine**2)
        / ((2.0 + square) * arrays.power(1.0 + square - 2.0 * _FORWARD * cosine, 1.5))
    )  # fmt: skip
    radiance = np.zeros((len(away), 3))
    passed = np.zeros((len(away), 3))
    for near_m, far in pairwise(edges):
        length = (far - near_m) * reach
        point = eye + (0.5 * (near_m + far) * reach)[:, None] * away
        density = densities(np.linalg.norm(point, axis=1) - _EARTH_M)
        inside = arrays.matmul(density, EXTINCTION) * length[:, None]
        sunlit = arrays.exp(-passed - 0.5 * inside - optical_depth_to_sun(point, sun))
        scattered = density[:, :1] * air_phase[:, None] * _AIR + density[:, 1:2] * haze_phase[:, None] * _HAZE
        radiance += sunlit * scattered * length[:, None]
        passed += inside
    radiance += _AGAIN * (1.0 - arrays.exp(-passed)) * (dome_weights().reshape(-1, 1) * radiance).sum(axis=0)
    dome: Float64 = radiance.reshape(DOME, DOME, 3)
    dome.flags.writeable = False
    return dome


def dome_directions() -> Float64:
    """Return the directions (DOME, DOME, 3) of a dome's samples, moved up to the horizon where below it."""
    line = np.linspace(-1.0, 1.0, DOME)
    x, y = np.meshgrid(line, line)
    square = x * x + y * y
    away = np.stack([2.0 * x, 2.0 * y, 1.0 - square], axis=-1) / (1.0 + square)[..., None]
    away[..., 2] = np.maximum(away[..., 2], 0.0)
    return away / np.linalg.norm(away, axis=-1, keepdims=True)


def dome_weights() -> Float64:
    """Return solid angles (DOME, DOME) times the cosine from the zenith over pi, to sum radiance to irradiance."""
    line = np.linspace(-1.0, 1.0, DOME)
    x, y = np.meshgrid(line, line)
    square = x * x + y * y
    solid = (2.0 / (1.0 + square)) ** 2 * (line[1] - line[0]) ** 2
    weights: Float64 = np.where(square < 1.0, solid * (1.0 - square) / (1.0 + square), 0.0)
    return weights / weights.sum()


EXTINCTION: Final = np.stack([_AIR, _HAZE_TAKES * _HAZE, _OZONE])


def densities(height_m: Float64) -> Float64:
    """Return the densities (..., 3) of air, haze and ozone, relative to the maximum of each."""
    height = np.maximum(height_m, 0.0)
    ozone = np.maximum(1.0 - np.abs(height - _OZONE_M) / _OZONE_HALF_M, 0.0)
    return np.stack([arrays.exp(-height / _AIR_M), arrays.exp(-height / _HAZE_M), ozone], axis=-1)


def distance_to_sphere(start: Float64, away: Float64, radius: float) -> Float64:
    """Return the distances (N,) from points inside a sphere around the earth's centre to the sphere."""
    along = np.einsum("ni,ni->n", start, away)
    return -along + np.sqrt(along**2 - np.einsum("ni,ni->n", start, start) + radius**2)


def optical_depth_to_sun(points: Float64, sun: Float64) -> Float64:
    """Return the optical depths (N, 3) from points (N, 3) to the sun; huge where the earth hides the sun."""
    reach = distance_to_sphere(points, np.broadcast_to(sun, points.shape), _TOP_M)
    along = arrays.matmul(points, sun)
    passing = np.sqrt(np.maximum(np.einsum("ni,ni->n", points, points) - along**2, 0.0))
    hidden = (along < 0.0) & (passing < _EARTH_M)
    depth = np.zeros_like(points)
    for near_m, far in pairwise(np.linspace(0.0, 1.0, _SUN_STEPS + 1) ** 2):
        point = points + (0.5 * (near_m + far) * reach)[:, None] * sun
        depth += (far - near_m) * (arrays.matmul(densities(np.linalg.norm(point, axis=1) - _EARTH_M), EXTINCTION))
    depth *= reach[:, None]
    depth[hidden] = _NO_LIGHT
    return depth
