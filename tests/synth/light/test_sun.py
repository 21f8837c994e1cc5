"""Tests of the sun against published values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.recordings.light import light_label, solar_elevation_deg
from mirror.synth.light.sun import air_mass, instant_of, season_of, sun_direction, sunlight
from tests.draws import draws


def ns(iso: str) -> int:
    return int(np.datetime64(iso, "ns").astype(np.int64))


def test_sun_rises_in_the_east_at_the_equinox_and_culminates_in_the_south() -> None:
    # 2025-03-20 09:01 UTC is the equinox; at longitude 0 the sun rises about 06:07 and culminates about 12:07.
    rise = sun_direction(ns("2025-03-20T06:07:20"), 0.0, 50.0)
    assert abs(rise[2]) < 0.01
    assert rise[0] > 0.999
    noon = sun_direction(ns("2025-03-20T12:07:20"), 0.0, 50.0)
    assert abs(noon[0]) < 0.005
    assert noon[1] < 0
    assert np.degrees(np.arcsin(noon[2])) == pytest.approx(40.0, abs=0.1)


@pytest.mark.parametrize(("longitude", "latitude"), [(0.0, 0.0), (113.3, 23.1), (-70.0, -53.0), (15.6, 78.2)])
def test_sun_direction_is_a_unit_vector_at_the_stated_elevation(longitude: float, latitude: float) -> None:
    stamps = ns("2025-01-01") + np.arange(0, 365 * 24, 7) * 3_600_000_000_000
    sun = sun_direction(stamps, longitude, latitude)
    assert np.abs(np.linalg.norm(sun, axis=1) - 1).max() < 1e-11
    elevation = solar_elevation_deg(stamps, longitude, latitude)
    assert np.abs(np.degrees(np.arcsin(sun[:, 2])) - elevation).max() < 1e-6


@pytest.mark.parametrize("light", ["day", "dusk", "night"])
@pytest.mark.parametrize("morning", [True, False])
def test_instant_of_has_the_requested_light(light: str, morning: bool) -> None:
    for date in ("2025-01-15", "2025-06-21", "2025-10-30"):
        for place in ((113.3, 23.1), (8.4, 49.0), (-122.0, 37.0)):
            instant = instant_of(date, light, *place, morning=morning)
            assert light_label(float(solar_elevation_deg(instant, *place))) == light
            assert (sun_direction(instant, *place)[0] > 0) == morning or light == "night"


def test_air_mass_matches_the_published_table() -> None:
    # F. Kasten and A. Young, Applied Optics 28 (1989), table I.
    for elevation, mass in ((90.0, 1.0), (30.0, 1.9939), (10.0, 5.5841), (5.0, 10.3164), (0.0, 38.0868)):
        assert air_mass(elevation) == pytest.approx(mass, rel=6e-3)


@given(st.floats(-90.0, 90.0), st.floats(0.0, 5.0))
def test_a_higher_sun_is_brighter_and_less_red(elevation: float, more: float) -> None:
    low, high = sunlight(elevation), sunlight(min(elevation + more, 90.0))
    # The formula is not exactly monotonic near the zenith.
    assert (high >= (1.0 - 1e-6) * low).all()
    assert (np.isfinite(low) & (low >= 0.0)).all()
    if low[0] > 1e-3:
        assert high[2] / high[0] >= low[2] / low[0] - 1e-6


def test_sunlight_is_white_at_45_degrees_and_none_at_night() -> None:
    assert sunlight(45.0) == pytest.approx([1.0, 1.0, 1.0])
    assert not sunlight(-0.3).any()


def test_seasons_of_the_hemispheres_differ_by_half_a_year() -> None:
    assert season_of(ns("2025-01-01T12:00"), 49.0) == 0.0
    assert season_of(ns("2025-07-02T12:00"), 49.0) == pytest.approx(0.5, abs=0.003)
    assert season_of(ns("2025-07-03T12:00"), -33.0) == pytest.approx(0.0, abs=0.003)


@settings(max_examples=draws(50))
@given(st.integers(0, 4_000_000_000), st.floats(-90.0, 90.0))
def test_season_is_a_fraction_of_the_year(seconds: int, latitude: float) -> None:
    assert 0.0 <= season_of(seconds * 1_000_000_000, latitude) < 1.0
