import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.metrics.images.colour_correction import correct_colours, psnr_cc
from mirror.metrics.images.psnr import psnr
from tests.draws import draws
from tests.metrics.images.references import corrected_by_lstsq, ellipse, street


def check(render, truth, mask=None, error=1e-6):
    colours, expected, ranks = corrected_by_lstsq(render / 255, truth / 255, mask)
    found = psnr_cc(render, truth, mask=mask)
    assert found.db == pytest.approx(expected, abs=error)
    correction = correct_colours(render, truth, mask=mask)
    np.testing.assert_array_equal(correction.ranks, ranks)
    np.testing.assert_allclose(correction.colours, colours, atol=1e-7)
    assert found.rank == np.min(ranks)
    return found


def test_it_is_the_least_squares_fit():
    render, truth = street()
    found = check(render, truth, error=1e-9)
    assert found.full_rank
    assert found.db > psnr(render, truth) + 3


def test_saturated_pixels_are_left_out_of_fits_but_not_of_the_score():
    render, truth = street()
    bright = np.clip(render.astype(int) + 70, 0, 255).astype(np.uint8)
    assert (bright == 255).any(axis=2).mean() > 0.05
    check(bright, truth)
    check(render, np.clip(truth.astype(int) - 60, 0, 255).astype(np.uint8))


def test_a_mask_takes_pixels_out_of_both():
    render, truth = street()
    mask = ellipse(90, 160, slice(10, 80), slice(20, 150))
    found = check(render, truth, mask)
    render[~mask], truth[~mask] = 99, 3
    assert psnr_cc(render, truth, mask=mask).db == pytest.approx(found.db, abs=1e-12)


def test_a_quadratic_warp_is_undone():
    rng = np.random.default_rng(0)
    render = rng.uniform(0.2, 0.8, (40, 50, 3))
    r, g, b = np.moveaxis(render, -1, 0)
    truth = np.stack([0.1 + 0.7 * r * r + 0.1 * g, 0.2 + 0.5 * r * b, 0.9 * b - 0.1 * g * g + 0.05], axis=-1)
    assert np.abs(correct_colours(render, truth, data_range=1.0).colours - truth.reshape(-1, 3)).max() < 1e-13
    assert psnr_cc(render, truth, data_range=1.0).db == math.inf


def test_equal_images_are_infinite_whatever_their_colours():
    _, truth = street()
    assert psnr_cc(truth, truth).db == math.inf
    truth[..., 2] = 255
    assert psnr_cc(truth, truth).db == math.inf


@pytest.mark.parametrize("spread", [1e-2, 1e-4])
def test_nearly_grey_images_lose_no_digits(spread):
    rng = np.random.default_rng(0)
    grey = rng.uniform(0.2, 0.8, (60, 60, 1))
    render = grey + spread * rng.standard_normal((60, 60, 3))
    truth = np.clip(0.9 * render**1.2 + 0.02 * rng.standard_normal(render.shape), 0.01, 0.99)
    _, expected, _ = corrected_by_lstsq(render, truth)
    found = psnr_cc(render, truth, data_range=1.0)
    assert found.full_rank
    assert found.db == pytest.approx(expected, abs=1e-6)


def test_a_constant_colour_is_warped_to_the_mean_with_rank_one():
    _, truth = street()
    truth = np.clip(truth, 1, 254)
    render = np.full_like(truth, 90)
    found = check(render, truth)
    assert (found.rank, found.terms, found.full_rank) == (1, 10, False)
    assert found.db == pytest.approx(-10 * math.log10(np.var(truth / 255, axis=(0, 1)).mean()), abs=1e-9)


def test_grey_images_have_rank_three_and_two_colours_two():
    render, truth = street()
    truth = np.clip(truth, 1, 254)
    grey = np.repeat(np.clip(render[..., :1], 1, 254), 3, axis=2)
    first = correct_colours(grey, truth, iterations=1)
    assert first.ranks.tolist() == [[3, 3, 3]]
    np.testing.assert_allclose(first.colours, corrected_by_lstsq(grey / 255, truth / 255, iterations=1)[0], atol=1e-9)
    two = np.where(grey > 120, np.uint8([200, 100, 50]), np.uint8([20, 30, 70]))
    assert check(two, truth).rank == 2


def test_the_fit_of_least_norm_decides_pixels_that_no_fit_saw():
    _, truth = street()
    truth = np.clip(truth, 1, 254)
    render = np.full_like(truth, 90)
    render[:20] = 255
    check(render, truth)


def test_one_pixel():
    found = psnr_cc(np.uint8([[[50, 60, 70]]]), np.uint8([[[80, 90, 100]]]))
    assert found.db == math.inf
    assert found.rank == 1


def test_a_channel_that_is_all_saturated_has_rank_zero_and_turns_black():
    render, truth = street()
    render[..., 2] = 255
    correction = correct_colours(render, truth)
    assert correction.ranks[:, 2].tolist() == [0] * 5
    assert (correction.colours[:, 2] == 0).all()
    assert psnr_cc(render, truth).rank == 0


def test_types_and_ranges_agree():
    render, truth = street()
    expected = psnr_cc(render, truth).db
    for scale, dtype in ((1 / 255, np.float64), (1.0, np.float64), (257, np.uint16)):
        pair = [(image.astype(np.float64) * scale).astype(dtype) for image in (render, truth)]
        assert psnr_cc(*pair, data_range=255.0 * scale).db == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_pixels_that_are_not_finite_are_an_error(bad):
    render, truth = (image / 255.0 for image in street(20, 20))
    render[4, 5, 2] = bad
    with pytest.raises(UsageError, match="row 4, column 5, channel 2"):
        psnr_cc(render, truth, data_range=1.0)


def test_nothing_to_fit_is_an_error():
    render, truth = street(20, 20)
    with pytest.raises(UsageError, match="selects no pixel"):
        psnr_cc(render, truth, mask=np.zeros((20, 20), bool))
    with pytest.raises(UsageError, match="0 iterations"):
        psnr_cc(render, truth, iterations=0)


@settings(max_examples=draws(25), deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 12), st.integers(1, 40))
def test_images_of_few_colours(seed, colours, spread):
    rng = np.random.default_rng(seed)
    palette = rng.integers(20, 200, (colours, 3))
    render = (palette[rng.integers(colours, size=(30, 40))] + rng.integers(0, 2, (30, 40, 1)) * spread).astype(np.uint8)
    truth = np.clip(render.astype(int) + rng.integers(-10, 11, render.shape), 1, 254).astype(np.uint8)
    expected = corrected_by_lstsq(render / 255, truth / 255, iterations=1)[0]
    found = correct_colours(render, truth, iterations=1).colours
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_floats_of_either_size_are_the_same_image() -> None:
    # Every float32 is a float64: the fit and the score have the same numbers to work on.
    draw = np.random.default_rng(0)
    truth = draw.random((24, 32, 3)).astype(np.float32)
    render = np.clip(0.8 * truth + 0.05 * draw.standard_normal(truth.shape), 0.0, 1.0).astype(np.float32)
    wide = psnr_cc(render.astype(np.float64), truth.astype(np.float64), data_range=1.0)
    assert psnr_cc(render, truth, data_range=1.0) == wide and 20.0 < wide.db < 40.0


def large(image):
    """The image in four quarters, one of them mirrored: large enough for the compiled kernels."""
    whole = np.tile(image, (2, 2, 1))
    whole[: len(image), : image.shape[1]] = image[::-1]
    return whole


@pytest.mark.parametrize("kind", ["as it is", "bright", "grey", "nearly grey", "flat", "white"])
def test_large_images_have_the_least_squares_fit_too(kind):
    render, truth = map(large, street())
    assert render.shape[0] * render.shape[1] >= 30_000
    if kind == "bright":
        render = np.clip(render.astype(int) + 70, 0, 255).astype(np.uint8)
    elif "grey" in kind:
        render[...] = render[..., :1]
        render[::2, ::3, 1] += kind == "nearly grey"
    elif kind != "as it is":
        render[...] = 77 if kind == "flat" else 255
    check(render, truth)
    mask = np.random.default_rng(3).random(render.shape[:2]) < 0.8
    check(render, truth, mask)


def test_large_and_small_images_are_fitted_alike():
    render, truth = street()
    # The same pixels once and four times over have the same fit.
    small, whole = psnr_cc(render, truth), psnr_cc(large(render), large(truth))
    assert whole.db == pytest.approx(small.db, abs=1e-11) and whole.rank == small.rank


def test_a_colour_at_the_bound_of_saturation_takes_part_in_the_fit() -> None:
    """Half a step of 255 is the least colour that a fit sees: without these pixels it would be exact elsewhere."""
    rng = np.random.default_rng(0)
    render = rng.uniform(0.2, 0.8, (20, 20, 3))
    truth = 0.5 * render + 0.1
    render[:2] = 0.5 / 255.0
    truth[:2] = 0.7
    colours, expected, _ = corrected_by_lstsq(render, truth, None)
    assert np.abs(colours - truth.reshape(-1, 3))[40:].max() > 1e-3
    assert psnr_cc(render, truth, data_range=1.0).db == pytest.approx(expected, abs=1e-6)
