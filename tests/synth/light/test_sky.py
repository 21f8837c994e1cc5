"""Tests of the sky against closed forms and numerical integrals."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.synth.light import atmosphere
from mirror.synth.light.atmosphere import clear_dome, dome_directions, dome_weights
from mirror.synth.light.clouds import LEVELS, SIDE, cloud_field
from mirror.synth.light.condition import Condition
from mirror.synth.light.lighting import LIGHTING, Lighting, compute_lighting
from mirror.synth.light.sky import sky
from mirror.synth.light.sun import instant_of
from mirror.synth.model import flat
from tests.draws import draws

PLACE = (8.4, 49.0)


@cache
def lighting_of(light: str, weather: str) -> Lighting:
    return compute_lighting(Condition(instant_of("2025-05-10", light, *PLACE), light, weather), *PLACE)


def radiance_at(one: Lighting, direction: np.ndarray, spread: float = 0.002) -> np.ndarray:
    setting = one.record.reshape(1).view(flat(LIGHTING))[0]
    return np.array(sky(one.dome, one.clouds, setting, *direction, spread))


def test_vertical_optical_depth_matches_the_closed_form() -> None:
    up = np.array([0.0, 0.0, 1.0])
    for height in (0.0, 2_000.0, 9_000.0):
        depth = atmosphere.optical_depth_to_sun(np.array([[0.0, 0.0, 6_371e3 + height]]), up)[0]
        air = 8_000.0 * np.exp(-height / 8_000.0) * np.array([8.7e-6, 13.6e-6, 26.5e-6])
        haze = 1_200.0 * np.exp(-height / 1_200.0) * 1.1 * np.array([7.2e-6, 7.6e-6, 8.3e-6])
        ozone = 15_000.0 * np.array([2.3e-6, 1.7e-6, 0.12e-6])
        assert depth == pytest.approx(air + haze + ozone, rel=0.03)


def test_slanted_optical_depth_matches_a_fine_sum() -> None:
    place = np.array([0.0, 0.0, 6_371e3 + 12_000.0])
    for elevation in (-3.0, 0.0, 4.0, 25.0):
        sun = np.array([np.cos(np.radians(elevation)), 0.0, np.sin(np.radians(elevation))])
        reach = atmosphere.distance_to_sphere(place[None], sun[None], 6_431e3)[0]
        steps = (np.arange(20_000) + 0.5) / 20_000 * reach
        height = np.linalg.norm(place + steps[:, None] * sun, axis=1) - 6_371e3
        fine = (atmosphere.densities(height) @ atmosphere.EXTINCTION).sum(axis=0) * reach / 20_000
        assert atmosphere.optical_depth_to_sun(place[None], sun)[0] == pytest.approx(fine, rel=0.03)


def test_points_in_the_earths_shadow_get_no_sunlight() -> None:
    sun = np.array([np.cos(np.radians(-8.0)), 0.0, np.sin(np.radians(-8.0))])
    heights = np.array([10.0, 30_000.0, 64_000.0])
    # 8 degrees below the horizon, sunlight passes at heights above R (1 / cos 8 - 1) = 62.6 km.
    points = np.stack([np.zeros(3), np.zeros(3), 6_371e3 + heights], axis=1)
    assert (atmosphere.optical_depth_to_sun(points, sun)[:, 0] > 100.0).tolist() == [True, True, False]


def test_sky_dome_is_symmetric_about_the_sun() -> None:
    dome = clear_dome(25.0, 90.0)
    assert dome == pytest.approx(dome[:, ::-1], rel=1e-9)
    assert dome[70:].mean() > dome[:26].mean()
    assert dome_weights().sum() == pytest.approx(1.0)
    assert np.linalg.norm(dome_directions(), axis=-1) == pytest.approx(np.ones((96, 96)))


def test_zenith_is_bluest_and_dusk_is_red_at_the_sunset() -> None:
    for elevation in (60.0, 20.0, -2.0):
        dome = clear_dome(elevation, 0.0)
        zenith, before, behind = dome[48, 48], dome[48, 92], dome[48, 3]
        assert zenith[2] / zenith[0] > max(before[2] / before[0], 1.3)
        assert before.sum() > behind.sum()
    assert before[0] > 2.0 * before[2]


@pytest.mark.parametrize("weather", ["clear", "clouds", "rain"])
@pytest.mark.parametrize("light", ["day", "dusk"])
def test_ground_light_equals_the_integral_over_the_sky(light: str, weather: str) -> None:
    one = lighting_of(light, weather)
    rng = np.random.default_rng(1)
    # For cosine-weighted directions the mean radiance equals the light on the ground.
    i, j = np.meshgrid(np.arange(60), np.arange(60))
    radius, angle = np.sqrt((i + rng.random(i.shape)) / 60), 2 * np.pi * (j + rng.random(j.shape)) / 60
    away = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=-1).reshape(-1, 3)
    radiance = np.array(
        [radiance_at(one, direction, 0.02) for direction in away if direction @ one.record["sun"] < 0.9999]
    )
    assert one.record["sky_light"] == pytest.approx(radiance.mean(axis=0), rel=0.03)


def test_light_increases_with_the_suns_elevation() -> None:
    noon = int(np.datetime64("2025-03-20T12:07", "ns").astype(np.int64))
    total = []
    for minutes in range(0, 441, 88):
        record = compute_lighting(Condition(noon - (440 - minutes) * 60_000_000_000, "day", "clear"), 0.0, 0.0).record
        level = max(record["sun"][2], 0.0) * record["sunlight"] + record["sky_light"]
        total.append(level @ [0.2126, 0.7152, 0.0722])
    # At night, town lights illuminate the clouds independently of the sun.
    assert (np.diff(total) > -5e-4).all()
    assert total[0] < 0.02 * total[-1]


def test_direct_sunlight_is_about_four_times_the_sky_light() -> None:
    record = lighting_of("day", "clear").record
    luminance = np.array([0.2126, 0.7152, 0.0722])
    ratio = record["sun"][2] * (record["sunlight"] @ luminance) / (record["sky_light"] @ luminance)
    assert 2.5 < ratio < 5.0


@settings(max_examples=draws(60), deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), st.floats(0.0, 0.5), st.floats(0.0, 1e4))
def test_sky_is_finite_in_all_directions(vector: list[float], spread: float, time_s: float) -> None:
    direction = np.array(vector)
    length = np.linalg.norm(direction)
    direction = direction / length if length > 1e-6 else np.array([0.0, 0.0, -1.0])
    one = lighting_of("day", "clear")
    moved = Lighting(one.at(time_s), one.dome, one.clouds)
    radiance = radiance_at(moved, direction, spread)
    assert np.isfinite(radiance).all()
    assert (radiance > 0.0).all()


def test_sky_shows_the_sun_and_is_constant_below_the_horizon() -> None:
    one = lighting_of("day", "clear")
    sun = one.record["sun"]
    aside = np.array([-sun[1], sun[0], 0.0])
    assert (
        radiance_at(one, sun)[1]
        > 20 * radiance_at(one, np.cos(0.05) * sun + np.sin(0.05) * aside / np.linalg.norm(aside))[1]
    )
    assert radiance_at(one, np.array([0.6, 0.8, -1e-6])) == pytest.approx(
        radiance_at(one, np.array([0.6, 0.8, 0.0])), rel=1e-4
    )


def test_clouds_tile_move_and_have_the_stated_cover() -> None:
    field = cloud_field()
    finest = field[: SIDE * SIDE].reshape(SIDE, SIDE)
    assert len(field) == sum((SIDE >> level) ** 2 for level in range(LEVELS))
    for share in (0.1, 0.27, 0.6):
        assert (finest > 1.0 - share).mean() == pytest.approx(share, abs=0.01)
    start = 0
    for level in range(LEVELS):
        side = SIDE >> level
        one = field[start : start + side * side].reshape(side, side)
        start += side * side
        assert one.mean() == pytest.approx(finest.mean(), abs=1e-5)
        seam = np.abs(one[:, 0] - one[:, -1]).mean()
        assert seam < 2.5 * np.abs(np.diff(one, axis=1)).mean()
    lighting_one = lighting_of("day", "clear")
    shift = lighting_one.at(100.0)["cloud_shift"] - lighting_one.record["cloud_shift"]
    assert np.hypot(*shift) == pytest.approx(0.4)
