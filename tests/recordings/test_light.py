"""Solar elevation against published values, and labels at their limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.recordings.light import light_label, solar_elevation_deg


def ns(moment: str) -> np.int64:
    return np.datetime64(moment, "ns").astype(np.int64)


@pytest.mark.parametrize(
    ("moment", "longitude", "latitude", "expected", "tolerance"),
    [
        # Reda and Andreas, NREL/TP-560-34302 (2008), appendix A.5: elevation without refraction.
        ("2003-10-17T19:30:30", -105.1786, 39.742476, 39.872046, 0.01),
        # Meeus, Astronomical Algorithms, example 25.b (VSOP87): at the pole the elevation is the declination.
        ("1992-10-12T23:59:01", 0.0, 90.0, -7.783817, 0.01),
        # Equinox of 2024-03-20 03:06 UTC and solstice of 2024-06-20 20:51 UTC (Astronomical Almanac).
        ("2024-03-20T03:06:20", 77.0, 90.0, 0.0, 0.01),
        ("2024-06-20T20:51:00", -12.0, -90.0, -23.4385, 0.01),
        # Sunrise and sunset of London on 2024-06-21 as published, to the minute: -50' by definition.
        ("2024-06-21T03:43:00", -0.1278, 51.5074, -0.833, 0.15),
        ("2024-06-21T20:21:30", -0.1278, 51.5074, -0.833, 0.15),
    ],
)
def test_agrees_with_published_values(
    moment: str, longitude: float, latitude: float, expected: float, tolerance: float
) -> None:
    assert abs(float(solar_elevation_deg(ns(moment), longitude, latitude)) - expected) < tolerance


@given(st.integers(0, 4 * 10**18), st.floats(-180, 180), st.floats(-90, 90))
def test_antipodes_have_opposite_elevations(stamp: int, longitude: float, latitude: float) -> None:
    here = solar_elevation_deg(stamp, longitude, latitude)
    there = solar_elevation_deg(stamp, longitude + 180, -latitude)
    assert abs(float(here + there)) < 1e-6


def test_is_batched_and_keeps_nan() -> None:
    found = solar_elevation_deg(np.full(3, ns("2021-08-05T17:34:46")), [-79.47, np.nan, 100.5], [43.8, 43.8, -43.8])
    assert np.isnan(found[1])
    assert found[0] > 60
    assert found[2] < -60


@pytest.mark.parametrize(
    ("elevation", "label"),
    [(40.0, "day"), (0.0, "day"), (-0.001, "dusk"), (-5.999, "dusk"), (-6.0, "night"), (-50.0, "night")],
)
def test_labels(elevation: float, label: str) -> None:
    assert light_label(elevation) == label
