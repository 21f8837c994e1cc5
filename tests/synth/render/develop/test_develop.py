"""Tests of image development against a float64 reference, and of each of its effects."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.synth.light.condition import Condition, Effects
from mirror.synth.light.lighting import LIGHTING, compute_lighting
from mirror.synth.light.sun import instant_of
from mirror.synth.render.develop import CameraResponse, compute_exposure, develop, draw_camera_response, draw_lens_drops
from mirror.synth.render.develop.curve import film, film_table, gaussian_table
from mirror.synth.render.develop.drops import DROP, refract_drops
from mirror.synth.render.develop.glare import glare
from tests.draws import draws

PLAIN = CameraResponse()
NONE = Effects.none()
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def record(light: str = "day", weather: str = "clear") -> np.ndarray:
    return compute_lighting(Condition(instant_of("2025-05-10", light, 8.4, 49.0), light, weather), 8.4, 49.0).record


def fixed(exposure: float, read: float = 0.0, shot: float = 0.0) -> np.ndarray:
    one = np.zeros(1, LIGHTING)[0]
    one["exposure"], one["middle"], one["white"] = exposure, 0.2, (1.2, 1.0, 0.8)
    one["read_noise"], one["shot_noise"] = read, shot
    return one


def street(height: int = 90, width: int = 160, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (0.3 * np.exp(rng.normal(0.0, 1.0, (height, width, 3)))).astype(np.float32)


def reference(radiance: np.ndarray, gains: np.ndarray, vignette: float, spilt: np.ndarray | None) -> np.ndarray:
    """Unrounded levels, computed step by step in float64."""
    height, width = radiance.shape[:2]
    light = radiance.astype(np.float64) * gains
    if spilt is not None:
        y = np.clip((np.arange(height) + 0.5) / 4 - 0.5, 0, spilt.shape[0] - 1)
        x = np.clip((np.arange(width) + 0.5) / 4 - 0.5, 0, spilt.shape[1] - 1)
        rows = np.stack(
            [[np.interp(y, np.arange(len(c)), c) for c in channel.T] for channel in np.moveaxis(spilt, 2, 0)]
        )
        light += np.stack([[np.interp(x, np.arange(len(r)), r) for r in c.T] for c in rows], axis=-1)
    down, across = np.arange(height) + 0.5 - height / 2, np.arange(width) + 0.5 - width / 2
    square = (across**2 + down[:, None] ** 2) / (0.25 * (height**2 + width**2))
    light /= (1 + vignette * square[..., None]) ** 2
    grey = (light @ LUMINANCE)[..., None]
    light = np.clip(grey + 1.12 * (light - grey), 0.0, 16.0)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    toed = coded**2 * 1.022 / (coded + 0.022)
    return 255.0 * np.where(toed < 0.62, toed, 0.62 + 0.38 * (1 - np.exp(-(toed - 0.62) / 0.38)))[..., ::-1]


@pytest.mark.parametrize("bright", [0.01, 1.0, 30.0])
def test_levels_match_the_float64_reference_to_half_a_level(bright: float) -> None:
    radiance, response = bright * street(), CameraResponse(tint=(0.97, 1.01, 1.04), vignette=0.3)
    effects = replace(NONE, white_balance=True, vignetting=True)
    out = develop(radiance, fixed(0.7), response, effects, 0)
    exact = reference(radiance, 0.7 * np.array([1.2, 1.0, 0.8]) * response.tint, 0.3, None)
    assert np.abs(out - exact).max() < 0.6


@pytest.mark.parametrize("size", [(90, 160), (61, 67)])
def test_glare_matches_the_float64_reference(size: tuple[int, int]) -> None:
    radiance = street(*size)
    radiance[20:24, 30:40] = 6.0
    out = develop(radiance, fixed(0.7), PLAIN, replace(NONE, bloom=True), 0)
    spilt = glare(radiance, np.full(3, 0.7))
    assert np.abs(out - reference(radiance, np.full(3, 0.7), 0.0, spilt)).max() < 0.6


def test_film_curve_is_smooth_and_increasing() -> None:
    light = np.linspace(0.0, 16.0, 400_001)
    level = film(light)
    assert level[0] == 0.0
    assert 0.99 < level[-1] < 1.0
    assert (np.diff(level) >= 0.0).all()
    slope = np.gradient(level, light)[1:]
    assert np.abs(np.diff(slope) / slope[1:])[1000:].max() < 0.01
    assert film(np.array([-1.0])) == 0.0
    assert (np.diff(film_table().astype(int)) >= 0).all()
    assert np.diff(film_table().astype(int)).max() == 1


def test_noise_has_mean_zero_and_the_stated_variance() -> None:
    read, shot, exposure = 0.004, 0.0006, 0.5
    effects = replace(NONE, noise=True)
    response = CameraResponse(noise=1.5)
    for value in (0.2, 0.5, 1.2):
        flat = np.full((400, 400, 3), value, np.float32)
        clean = reference(flat[:1, :1], np.full(3, exposure), 0.0, None)[0, 0, 0]
        noisy = develop(flat, fixed(exposure, read, shot), response, effects, 5).astype(np.float64)
        light = exposure * value
        slope = 255.0 * (film(np.array(light + 1e-4)) - film(np.array(light - 1e-4))) / 2e-4
        variance = slope**2 * 1.5**2 * (read**2 + shot * light) + 1.0 / 12.0
        assert noisy.var() == pytest.approx(variance, rel=0.06)
        # The curvature of the response shifts the mean by a share of the variance.
        assert abs(noisy.mean() - clean) < 0.03 * np.sqrt(variance) + 0.1
        channels = np.corrcoef(noisy.reshape(-1, 3).T)
        assert np.abs(channels - np.eye(3)).max() < 0.02
        for shifted in (noisy[1:, :, 0] - clean, noisy[:, 1:, 0] - clean):
            here = noisy[: shifted.shape[0], : shifted.shape[1], 0] - clean
            assert abs((here * shifted).mean()) < 0.02 * variance


def test_noise_table_is_normally_distributed() -> None:
    values = gaussian_table()
    assert values.mean() == pytest.approx(0.0, abs=1e-12)
    assert values.var() == pytest.approx(1.0)
    assert (values**4).mean() == pytest.approx(3.0, abs=0.03)


def test_images_with_different_seeds_differ_only_in_noise() -> None:
    radiance, one = street(), record("night")
    first, again, second = (develop(radiance, one, PLAIN, Effects(), seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert (first != second).mean() > 0.2
    assert np.abs(first.mean() - second.mean()) < 0.2


def test_result_does_not_depend_on_threads() -> None:
    one, response, drops = record("night", "rain"), draw_camera_response(4), draw_lens_drops(1, 0.5)
    motion = np.random.default_rng(0).normal(0.0, 3.0, (90, 160, 2)).astype(np.float32)

    def made(seed: int) -> bytes:
        return develop(street(seed=seed % 3), one, response, Effects(), seed, motion=motion, drops=drops).tobytes()

    alone = [made(seed) for seed in range(12)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(made, range(12))) == alone


@pytest.mark.parametrize("effect", ["noise", "vignetting", "white_balance", "bloom", "motion_blur", "lens_drops"])
def test_a_disabled_effect_has_no_influence(effect: str) -> None:
    radiance, one, response = street(), record("night", "rain"), draw_camera_response(7)
    radiance[40:44, 70:90] = 40.0
    drops, motion = draw_lens_drops(1, 90 / 160), np.full((90, 160, 2), 5.0, np.float32)
    assert len(drops)
    usual = replace(Effects(), exposure=False)
    off = develop(radiance, one, response, replace(usual, **{effect: False}), 3, motion=motion, drops=drops)
    bare, plain = one.copy(), response
    match effect:
        case "noise":
            bare["read_noise"] = bare["shot_noise"] = 0.0
        case "vignetting":
            plain = replace(response, vignette=0.0)
        case "white_balance":
            bare["white"], plain = 1.0, replace(response, tint=(1.0, 1.0, 1.0))
    expected = develop(
        radiance, bare, plain, replace(usual, bloom=effect != "bloom"), 3,
        motion=None if effect == "motion_blur" else motion, drops=None if effect == "lens_drops" else drops,
    )  # fmt: skip
    assert np.array_equal(off, expected)
    assert not np.array_equal(off, develop(radiance, one, response, usual, 3, motion=motion, drops=drops))


def test_vignette_depends_only_on_the_distance_from_the_middle() -> None:
    flat = np.full((101, 151, 3), 0.5, np.float32)
    out = develop(flat, fixed(0.5), CameraResponse(vignette=0.4), replace(NONE, vignetting=True), 0)[..., 0].astype(int)
    assert np.array_equal(out, out[::-1])
    assert np.array_equal(out, out[:, ::-1])
    y, x = np.mgrid[-50:51, -75:76]
    order = np.argsort((x**2 + y**2).ravel(), kind="stable")
    assert (np.diff(out.ravel()[order]) <= 0).all()
    assert out[50, 75] == round(255 * float(film(np.array(0.25))))
    assert out[0, 0] == pytest.approx(255 * film(np.array(0.25 / 1.4**2)), abs=1.0)


@given(st.floats(1e-3, 1e3), st.floats(1.0, 4.0))
def test_exposure_decreases_with_brightness_within_its_limits(bright: float, more: float) -> None:
    radiance, one = street(24, 32), fixed(1.0)
    low = compute_exposure(np.float32(bright) * radiance, one, PLAIN, Effects())
    high = compute_exposure(np.float32(bright * more) * radiance, one, PLAIN, Effects())
    assert 1 / 2.3 - 1e-6 <= high <= low * (1 + 1e-5) <= 2.3 * (1 + 2e-5)
    assert compute_exposure(np.float32(bright) * radiance, one, PLAIN, NONE) == 1.0
    assert compute_exposure(radiance, one, CameraResponse(exposure_ev=1.0), Effects()) == pytest.approx(
        2 * compute_exposure(radiance, one, PLAIN, Effects())
    )


def test_only_values_above_white_cause_glare() -> None:
    dark = np.full((256, 384, 3), 0.9, np.float32)
    assert glare(dark, np.ones(3)) is None
    dark[:] = 0.0
    dark[124:132, 188:196] = 5.1
    spilt = glare(dark, np.ones(3))
    assert spilt is not None
    # Light above 1.1 times white is spread; some of it falls outside the image.
    assert 0.2 < 16 * spilt.sum() / (3 * 64 * 4.0) < 0.27
    assert spilt[32, 48, 0] == spilt.max()
    assert np.abs(spilt - spilt[::-1, ::-1]).max() < 0.05 * spilt.max()
    assert (spilt[32, 48:, 0] > 0.0).all()


def test_drops_change_only_their_own_pixels() -> None:
    assert sum(len(draw_lens_drops(seed, 0.5625)) == 0 for seed in range(200)) == pytest.approx(80, abs=25)
    radiance = street()
    drops = np.zeros(1, DROP)
    drops[0] = (0.5, 0.25, 0.06, 0.08, 0.2, 0.9)
    out = refract_drops(radiance, drops)
    y, x = np.mgrid[:90, :160] + 0.5
    inside = ((x / 160 - 0.5) / 0.06) ** 2 + ((y / 160 - 0.25) / 0.08) ** 2 < 1.0
    assert np.array_equal(out[~inside], radiance[~inside])
    assert (out[inside] != radiance[inside]).mean() > 0.9
    assert np.array_equal(refract_drops(radiance, drops[:0]), radiance)
    # A drop shows the scene upside down.
    radiance[:] = np.linspace(0.0, 1.0, 90, dtype=np.float32)[:, None, None]
    shown = refract_drops(radiance, drops)[34:47, 80, 1]
    assert shown[0] > shown[-1]


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (2, 2)])
def test_tiny_images_are_developed(shape: tuple[int, int]) -> None:
    radiance = np.full((*shape, 3), 3.0, np.float32)
    motion = np.full((*shape, 2), 2.0, np.float32)
    out = develop(
        radiance, record(), draw_camera_response(1), Effects(), 0, motion=motion, drops=draw_lens_drops(1, 1.0)
    )
    assert out.shape == (*shape, 3)
    assert out.min() > 100


def test_black_maps_to_0_and_the_brightest_value_to_255() -> None:
    black, white = np.zeros((4, 4, 3), np.float32), np.full((4, 4, 3), 1e30, np.float32)
    assert not develop(black, fixed(1.0), PLAIN, NONE, 0).any()
    assert (develop(white, fixed(1.0), PLAIN, Effects(), 0) == 255).all()
    assert not develop(-white, fixed(1.0), PLAIN, NONE, 0).any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_radiance_with_nan_or_inf_is_refused(value: float) -> None:
    radiance = street()
    radiance[3, 4, 1] = value
    with pytest.raises(UsageError, match="finite"):
        develop(radiance, fixed(1.0), PLAIN, NONE, 0)


@pytest.mark.parametrize(
    "radiance", [np.zeros((4, 5), np.float32), np.zeros((4, 5, 3)), np.zeros((0, 5, 3), np.float32)]
)
def test_arrays_of_wrong_shape_or_type_are_refused(radiance: np.ndarray) -> None:
    with pytest.raises(UsageError, match="radiance"):
        develop(radiance, fixed(1.0), PLAIN, NONE, 0)
    with pytest.raises(UsageError, match="motion"):
        develop(street(), fixed(1.0), PLAIN, NONE, 0, motion=np.zeros((4, 4, 2), np.float32))


@settings(max_examples=draws(30))
@given(st.integers(0, 2**63 - 1))
def test_trained_responses_differ_within_small_limits(seed: int) -> None:
    response = draw_camera_response(seed)
    assert response == draw_camera_response(seed)
    assert abs(response.exposure_ev) < 1.0
    assert all(0.8 < gain < 1.2 for gain in response.tint)
    assert 0.1 <= response.vignette <= 0.3
