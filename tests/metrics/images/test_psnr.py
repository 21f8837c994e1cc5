import math
import pickle
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage.metrics import peak_signal_noise_ratio

from mirror.errors import UsageError
from mirror.metrics.images.psnr import Psnr, psnr
from tests.metrics.images.references import street


def exact(render, truth, data_range, mask=None):
    """PSNR from a sum of exact fractions."""
    if mask is not None:
        render, truth = render[mask], truth[mask]
    squares = sum((Fraction(a) - Fraction(b)) ** 2 for a, b in zip(render.ravel().tolist(), truth.ravel().tolist()))
    return -10 * math.log10(squares / render.size / Fraction(data_range) ** 2)


def test_psnr_is_that_of_scikit_image():
    render, truth = street()
    assert psnr(render, truth) == pytest.approx(peak_signal_noise_ratio(truth, render), abs=1e-12)
    floats = render / 255.0, truth / 255.0
    assert psnr(*floats, data_range=1.0) == pytest.approx(psnr(render, truth), abs=1e-12)


@given(st.data())
def test_integers_are_exact(data):
    dtype = data.draw(st.sampled_from([np.uint8, np.uint16]))
    shape = data.draw(st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 4)))
    render, truth = (data.draw(hnp.arrays(dtype, shape)) for _ in range(2))
    mask = data.draw(hnp.arrays(bool, shape[:2]))
    if not mask.any():
        assert math.isnan(psnr(render, truth, mask=mask))
    elif np.array_equal(render[mask], truth[mask]):
        assert psnr(render, truth, mask=mask) == math.inf
    else:
        assert psnr(render, truth, mask=mask) == pytest.approx(
            exact(render, truth, np.iinfo(dtype).max, mask), abs=1e-12
        )


def test_the_largest_difference_of_a_large_image_does_not_overflow():
    black = np.zeros((2160, 3840, 3), np.uint8)
    assert psnr(black, black + 255) == 0.0


def test_a_mask_selects():
    render, truth = street()
    mask = np.zeros(render.shape[:2], bool)
    mask[20:40, 30:70] = True
    assert psnr(render, truth, mask=mask) == psnr(render[20:40, 30:70], truth[20:40, 30:70])
    one = np.zeros_like(mask)
    one[5, 5] = True
    assert psnr(render, truth, mask=one) == pytest.approx(exact(render, truth, 255, one), abs=1e-12)


def test_images_may_be_views():
    render, truth = street()
    assert psnr(render[::2, ::-1, ::-1], truth[::2, ::-1, ::-1]) == psnr(render[::2].copy(), truth[::2].copy())
    assert psnr(render[..., 0], truth[..., 0]) == psnr(render[..., :1], truth[..., :1])


def test_an_empty_mask_is_nan_with_a_reason():
    render, truth = street()
    score = psnr(render, truth, mask=np.zeros(render.shape[:2], bool))
    assert math.isnan(score)
    assert score.reason == "the mask selects no pixel"
    assert pickle.loads(pickle.dumps(score)).reason == score.reason


@pytest.mark.parametrize("offset", [0.0, 1e4, 1e8])
def test_an_offset_costs_nothing_that_the_images_have(offset):
    rng = np.random.default_rng(0)
    # Multiples of 2^-20 near 1e8 are exact in float64.
    truth, render = (np.rint(rng.random((40, 50, 3)) * 2**20) / 2**20 for _ in range(2))
    assert psnr(render + offset, truth + offset, data_range=1.0) == psnr(render, truth, data_range=1.0)


def test_tiny_flat_and_single_pixels():
    tiny = np.array([[[1e-30, 2e-30, 3e-30]]])
    assert psnr(tiny, 2 * tiny, data_range=1e-30) == pytest.approx(-10 * math.log10(14 / 3), abs=1e-12)
    flat = np.full((1, 1), 0.25, np.float32)
    assert psnr(flat, flat, data_range=1.0) == math.inf
    assert psnr(flat, flat + np.float32(0.5), data_range=1.0) == pytest.approx(20 * math.log10(2), abs=1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_pixels_that_are_not_finite_are_named_unless_masked(bad):
    truth = np.zeros((4, 5, 3))
    render = truth + 0.1
    render[2, 3, 1] = bad
    with pytest.raises(UsageError, match="render, first at row 2, column 3, channel 1"):
        psnr(render, truth, data_range=1.0)
    mask = np.ones((4, 5), bool)
    mask[2, 3] = False
    assert psnr(render, truth, data_range=1.0, mask=mask) == pytest.approx(20.0, abs=1e-12)


def test_what_float64_cannot_hold_is_an_error():
    with pytest.raises(UsageError, match="beyond float64"):
        psnr(np.full((2, 2), 1e300), np.zeros((2, 2)), data_range=1.0)


@pytest.mark.parametrize(
    ("render", "truth", "options", "problem"),
    [
        (np.zeros((2, 3)), np.zeros((3, 2)), {"data_range": 1.0}, "render .2, 3. and truth .3, 2."),
        (np.zeros(3), np.zeros(3), {"data_range": 1.0}, "one shape"),
        (np.zeros((2, 2)), np.zeros((2, 2), np.float32), {"data_range": 1.0}, "render of float64, truth of float32"),
        (np.zeros((2, 2), int), np.zeros((2, 2), int), {}, "one type of"),
        (np.zeros((0, 2)), np.zeros((0, 2)), {"data_range": 1.0}, "without a pixel"),
        (np.zeros((2, 2)), np.zeros((2, 2)), {}, "data_range of float images is missing"),
        (np.zeros((2, 2)), np.zeros((2, 2)), {"data_range": 0.0}, "data_range 0.0"),
        (np.zeros((2, 2)), np.zeros((2, 2)), {"data_range": math.nan}, "data_range nan"),
        (np.zeros((2, 2)), np.zeros((2, 2)), {"data_range": 1.0, "mask": np.ones((2, 2), np.uint8)}, "mask > 0"),
    ],
)
def test_what_cannot_be_compared_is_refused(render, truth, options, problem):
    with pytest.raises(UsageError, match=problem):
        psnr(render, truth, **options)


def test_many_images_have_a_mean_and_a_pooled_score():
    render, truth = street()
    noisy = np.clip(truth.astype(int) + 40 * np.random.default_rng(1).integers(-1, 2, truth.shape), 0, 255)
    metric, other = Psnr(), Psnr()
    first, equal = metric.update(render, truth), metric.update(truth, truth)
    second = other.update(noisy.astype(np.uint8), truth)
    empty = other.update(render, truth, np.zeros(truth.shape[:2], bool))
    metric.merge(other)
    summary = metric.compute()
    assert (summary.images.n, summary.images.n_finite, summary.images.n_inf, summary.images.n_nan) == (4, 2, 1, 1)
    assert summary.images.mean == pytest.approx((first + second) / 2, abs=1e-12)
    assert summary.images.reasons == {"the mask selects no pixel": 1}
    assert (equal, math.isnan(empty)) == (math.inf, True)
    stacked = np.concatenate([render, truth, noisy]), np.concatenate([truth] * 3)
    assert summary.pooled == pytest.approx(psnr(*(image.astype(np.uint8) for image in stacked)), abs=1e-12)


def test_accumulators_know_when_they_have_nothing_and_what_they_cannot_join():
    assert math.isnan(Psnr().compute().pooled)
    assert Psnr().compute().images.mean.reason == "there is no score"
    with pytest.raises(UsageError, match="one range"):
        Psnr(1.0).merge(Psnr())
