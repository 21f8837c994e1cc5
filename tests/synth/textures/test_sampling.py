"""Tests of texture sampling: means over pixels against means of many samples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from mirror.synth.textures.atlas import atlas
from mirror.synth.textures.catalogue import BILLBOARDS, DIRECTION_SIGNS, PLATES, SHOP_SIGNS, TRAFFIC_SIGNS, Grain
from mirror.synth.textures.sampling import grain_at, image_at
from tests.draws import draws


def pixels(count: int, ratio: float, texels: tuple[float, float], seed: int) -> np.ndarray:
    """Random parallelograms (N, 6) in texels: position on a unit square, then both sides."""
    rng = np.random.default_rng(seed)
    wide = np.exp(rng.uniform(*np.log(texels), count))
    turn, lean = rng.uniform(0, 2 * np.pi, count), rng.uniform(-0.3, 0.3, count)
    along = np.c_[np.cos(turn), np.sin(turn)]
    across = np.c_[-along[:, 1], along[:, 0]]
    return np.c_[
        rng.uniform(0, 1, (count, 2)), ratio * wide[:, None] * along, wide[:, None] * (across + lean[:, None] * along)
    ]


def grains(grain: Grain, at: np.ndarray) -> np.ndarray:
    return np.array([grain_at(atlas().grains, atlas().grain_index, int(grain), *row) for row in at])


def images(number: int, at: np.ndarray) -> np.ndarray:
    return np.array([image_at(atlas().images, atlas().image_index, number, *row) for row in at])


@njit(cache=True)
def exact(texels: np.ndarray, at: np.ndarray, count: int, repeat: bool) -> np.ndarray:
    """Means of bilinear values at count x count points, in float64; texels (H, W, C), positions in texels."""
    high, wide, channels = texels.shape
    out = np.zeros((len(at), channels))
    for k in range(len(at)):
        for i in range(count):
            for j in range(count):
                a, b = (i + 0.5) / count - 0.5, (j + 0.5) / count - 0.5
                x = at[k, 0] + a * at[k, 2] + b * at[k, 4] - 0.5
                y = at[k, 1] + a * at[k, 3] + b * at[k, 5] - 0.5
                if not repeat:
                    x, y = min(max(x, 0.0), wide - 1.0), min(max(y, 0.0), high - 1.0)
                c, r = int(np.floor(x)), int(np.floor(y))
                u, v = x - c, y - r
                c1, r1 = c + 1, r + 1
                if repeat:
                    c, r, c1, r1 = c % wide, r % high, c1 % wide, r1 % high
                else:
                    c1, r1 = min(c1, wide - 1), min(r1, high - 1)
                for n in range(channels):
                    under = texels[r, c, n] * (1 - u) + texels[r, c1, n] * u
                    over = texels[r1, c, n] * (1 - u) + texels[r1, c1, n] * u
                    out[k, n] += (under * (1 - v) + over * v) / (count * count)
    return out


def finest(grain: Grain) -> tuple[np.ndarray, float]:
    first, log, scale = atlas().grain_index[grain, :3]
    size = 1 << int(log)
    return atlas().grains[int(first) : int(first) + size * size].reshape(size, size, 1).astype(np.float64), float(scale)


def light(number: int) -> np.ndarray:
    wide, high, _, first = atlas().image_index[number, :4]
    return (atlas().images[first : first + wide * high].reshape(high, wide, 3) / 255.0) ** 2


@pytest.mark.parametrize("ratio", [1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize(
    ("grain", "most"),
    [(Grain.PLASTER, 0.13), (Grain.STAINS, 0.04), (Grain.PAVING, 0.12), (Grain.BRICK, 0.11),
     (Grain.CONCRETE, 0.09), (Grain.GRASS, 0.15), (Grain.ASPHALT, 0.40)],
)  # fmt: skip
def test_grain_samples_match_the_mean_over_the_pixel(grain: Grain, most: float, ratio: float) -> None:
    texels, scale = finest(grain)
    at = pixels(300, ratio, (0.7, 12.0), 5)
    at[:, :2] *= len(texels)
    wanted = exact(texels, at, 32, True)[:, 0]
    error = np.sqrt(np.mean((grains(grain, at / scale) - wanted) ** 2))
    # A share of the remaining contrast at these pixel sizes.
    assert error < most * wanted.std()


@pytest.mark.parametrize("ratio", [1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize("number", [SHOP_SIGNS[1], BILLBOARDS[3], TRAFFIC_SIGNS[0], DIRECTION_SIGNS[0], PLATES[7]])
def test_image_samples_match_the_mean_over_the_pixel(number: int, ratio: float) -> None:
    texels = light(number)
    high, wide = texels.shape[:2]
    at = pixels(3000, ratio, (0.7, min(8.0, high / (3 * ratio))), 6)
    at[:, :2] *= (wide, high)
    # Inside the image, because its face ends at its border.
    reach = 0.5 * (np.abs(at[:, 2:4]) + np.abs(at[:, 4:6]))
    inside = ((at[:, :2] - reach > 0) & (at[:, :2] + reach < (wide, high))).all(axis=1)
    at = at[inside][:300]
    assert len(at) == 300
    wanted = exact(texels, at, 32, False)
    made = images(number, at / np.tile((wide, -high), 3) + np.array([0, 1, 0, 0, 0, 0]))
    error = np.sqrt(np.mean((made - wanted) ** 2))
    assert error < 0.02 and error < 0.08 * wanted.std()


@pytest.mark.parametrize("grain", [Grain.ASPHALT, Grain.STAINS, Grain.LEAVES])
def test_tiny_pixels_interpolate_texels(grain: Grain) -> None:
    texels, scale = finest(grain)
    at = pixels(200, 1.0, (1e-4, 1e-3), 7)
    at[:, :2] *= len(texels)
    wanted = exact(texels, at, 1, True)[:, 0]
    np.testing.assert_allclose(grains(grain, at / scale), wanted, atol=2e-4)


def test_huge_pixels_show_the_mean() -> None:
    for size in (1e2, 1e4, 1e8):
        for grain in Grain:
            assert grain_at(atlas().grains, atlas().grain_index, int(grain), 1.0, 2.0, size, 0.0, 0.0, size) == 1.0
    whole = light(PLATES[3]).mean(axis=(0, 1))
    for size in (1.0, 5.0, 1e6):
        np.testing.assert_allclose(images(PLATES[3], np.array([[0.5, 0.5, size, 0, 0, size]]))[0], whole, atol=0.1)


@given(
    st.sampled_from(list(Grain)),
    st.floats(-200, 200), st.floats(-200, 200), st.floats(0, 6.3), st.floats(1e-4, 2), st.floats(1.0, 12.0),
    st.integers(-5, 5), st.integers(-5, 5),
)  # fmt: skip
@settings(max_examples=draws(150), deadline=None)
def test_grains_tile(
    grain: Grain, u: float, v: float, turn: float, wide: float, ratio: float, right: int, up: int
) -> None:
    period = 1.0 / atlas().grain_index[grain, 2] * 2 ** atlas().grain_index[grain, 1]
    sides = (ratio * wide * np.cos(turn), ratio * wide * np.sin(turn), -wide * np.sin(turn), wide * np.cos(turn))
    here = grain_at(atlas().grains, atlas().grain_index, int(grain), u, v, *sides)
    there = grain_at(atlas().grains, atlas().grain_index, int(grain), u + right * period, v + up * period, *sides)
    assert abs(here - there) < 1e-3
    assert 0.05 < here < 5.0


@given(
    st.sampled_from([SHOP_SIGNS[0], PLATES[1], TRAFFIC_SIGNS[4]]),
    st.floats(-3, 4), st.floats(-3, 4), *[st.floats(-3, 3)] * 4,
)  # fmt: skip
@settings(max_examples=draws(150), deadline=None)
def test_image_samples_stay_within_the_texels_range(
    number: int, s: float, t: float, s1: float, t1: float, s2: float, t2: float
) -> None:
    texels = light(number)
    colour = np.array(image_at(atlas().images, atlas().image_index, number, s, t, s1, t1, s2, t2))
    assert (colour >= texels.min(axis=(0, 1)) - 0.01).all() and (colour <= texels.max(axis=(0, 1)) + 0.01).all()


def test_images_are_upright_and_not_mirrored() -> None:
    texels = light(PLATES[0])
    for s, t in ((0.02, 0.97), (0.05, 0.5), (0.9, 0.1)):
        row, column = int((1 - t) * texels.shape[0]), int(s * texels.shape[1])
        here = image_at(
            atlas().images, atlas().image_index, PLATES[0], (column + 0.5) / 256, 1 - (row + 0.5) / 64, 0, 0, 0, 0
        )
        np.testing.assert_allclose(here, texels[row, column], atol=1e-3)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300, 1e18])
def test_invalid_coordinates_read_no_memory_outside(bad: float) -> None:
    for place in range(6):
        row = [0.3, 0.4, 0.01, 0.0, 0.0, 0.01]
        row[place] = bad
        value = grain_at(atlas().grains, atlas().grain_index, 0, *row)
        assert np.isnan(value) or 0.0 < value < 5.0
        colour = np.array(image_at(atlas().images, atlas().image_index, 443, *row))
        assert np.isnan(colour).any() or ((colour >= 0.0) & (colour <= 1.0)).all()


def test_degenerate_pixels_are_valid() -> None:
    """Pixels without area, and pixels that are a line."""
    for sides in ((0, 0, 0, 0), (1, 0, 0, 0), (0, 0, 0, 1), (0.1, 0.1, 0.1, 0.1), (1e-12, 0, 0, 5)):
        assert 0.0 < grain_at(atlas().grains, atlas().grain_index, 2, 0.3, 0.2, *sides) < 3.0
        assert all(0.0 <= part <= 1.0 for part in image_at(atlas().images, atlas().image_index, 3, 0.3, 0.2, *sides))


def test_the_order_of_the_sides_does_not_matter() -> None:
    at = pixels(100, 3.0, (0.5, 10.0), 9) / 256
    swapped = at[:, [0, 1, 4, 5, 2, 3]]
    np.testing.assert_array_equal(grains(Grain.BRICK, at), grains(Grain.BRICK, swapped))
    np.testing.assert_allclose(grains(Grain.BRICK, at), grains(Grain.BRICK, at * [1, 1, -1, -1, 1, 1]), atol=1e-4)
