"""`psnr_invariant` against numpy's least squares in float64, and against recoloured renders."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.metrics.images.invariant import psnr_invariant
from tests.draws import draws
from tests.metrics.images.references import ellipse, street

# A value that is rounded to 255 steps is off by up to half a step, all errors equally likely.
ROUNDING_VARIANCE = (1 / 255) ** 2 / 12


def by_lstsq(render, truth, mask=None):
    """The definition, by the residuals of numpy's least squares; images in [0, 1]."""
    height, width = render.shape[:2]
    mask = np.ones((height, width), bool) if mask is None else mask
    y, x = np.mgrid[:height, :width]
    terms = np.concatenate([render[mask], np.stack([x, y, np.ones_like(x)], axis=2)[mask]], axis=1)
    fit = np.linalg.lstsq(terms, truth[mask], rcond=1e-12)[0]
    residuals = truth[mask] - terms @ fit
    covariance = residuals.T @ residuals / len(residuals)
    channels = render.shape[2]
    return -10 / channels * math.log10(np.linalg.det(covariance + ROUNDING_VARIANCE * np.eye(channels)))


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
def test_score_follows_its_definition(dtype):
    scale = {"uint8": 255, "uint16": 65535}.get(dtype, 1.0)
    render, truth = ((image / 255 * scale).astype(dtype) for image in street())
    mask = ellipse(90, 160, slice(10, 80), slice(20, 150))
    for used in (None, mask):
        expected = by_lstsq(render / np.float64(scale), truth / np.float64(scale), used)
        found = psnr_invariant(render, truth, mask=used, data_range=scale if scale == 1.0 else None)
        assert found == pytest.approx(expected, abs=1e-8)


@settings(max_examples=draws(25), deadline=None)
@given(st.integers(0, 10_000))
def test_no_invertible_recolouring_and_no_ramp_changes_the_score(seed):
    rng = np.random.default_rng(seed)
    render, truth = (image / 255.0 for image in street(24, 32, seed))
    matrix = rng.uniform(-1, 1, (3, 3)) + 2 * np.eye(3)
    y, x = np.mgrid[:24, :32]
    changed = render @ matrix.T + rng.uniform(-1, 1, 3) + rng.uniform(-1, 1) * (x / 32)[..., None] - (y / 24)[..., None]
    expected = psnr_invariant(render, truth, data_range=1.0)
    assert psnr_invariant(changed, truth, data_range=1.0) == pytest.approx(expected, abs=1e-6)


def test_giving_up_a_channel_costs():
    render, truth = street()
    y = np.mgrid[:90, :160][0] * 255 / 90
    honest = psnr_invariant(render, truth)
    for channels in ((0, 0, 0), (2, 2, 2)):
        assert psnr_invariant(render[..., channels], truth) < honest
    with_ramp = np.stack([render[..., 0], render[..., 1], y], axis=2).astype(np.uint8)
    assert psnr_invariant(with_ramp, truth) < honest


def test_equal_grey_and_constant_images_are_finite():
    _, truth = street()
    best = -10 * math.log10(ROUNDING_VARIANCE)
    assert psnr_invariant(truth, truth) == pytest.approx(best, abs=1e-5)
    grey = np.repeat(truth[..., :1], 3, axis=2)
    assert psnr_invariant(grey, grey) == pytest.approx(best, abs=1e-5)
    constant = np.full_like(truth, 90)
    assert psnr_invariant(constant, truth) == pytest.approx(by_lstsq(constant / 255, truth / 255), abs=1e-6)
    assert psnr_invariant(constant, constant) == pytest.approx(best, abs=1e-5)
    assert math.isfinite(psnr_invariant(np.uint8([[[1, 2, 3]]]), np.uint8([[[3, 2, 9]]])))
    empty = psnr_invariant(truth, truth, mask=np.zeros(truth.shape[:2], bool))
    assert math.isnan(empty) and empty.reason


def test_offset_floats_and_bad_pixels():
    render, truth = (image / 255.0 for image in street(24, 32))
    expected = psnr_invariant(render, truth, data_range=1.0)
    assert psnr_invariant(render + 1e3, truth, data_range=1.0) == pytest.approx(expected, abs=1e-4)
    render[4, 5, 2] = math.nan
    with pytest.raises(UsageError, match="row 4, column 5, channel 2"):
        psnr_invariant(render, truth, data_range=1.0)


def test_tensors_and_batches_agree_with_arrays():
    render, truth = street()
    expected = psnr_invariant(render, truth)
    assert psnr_invariant(np.stack([render, truth]), np.stack([truth, truth]), layout="nhwc")[0] == expected
    torch = pytest.importorskip("torch")
    images = [torch.from_numpy(image).permute(2, 0, 1) for image in (render, truth)]
    assert psnr_invariant(*images, layout="chw") == expected
