"""`psnr_affine` against numpy's least squares in float64, and against renders that are made for the fit."""

import ctypes
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mirror.errors import UsageError
from mirror.metrics.images.affine import psnr_affine
from mirror.metrics.images.psnr import psnr
from tests.draws import draws
from tests.metrics.images.references import affine_by_lstsq, ellipse, street


def check(render, truth, mask=None, scale=255.0):
    db, gains, offsets = affine_by_lstsq(render / scale, truth / scale, mask)
    found = psnr_affine(render, truth, mask=mask, data_range=scale if render.dtype.kind == "f" else None)
    assert found.db == pytest.approx(db, abs=1e-9)
    np.testing.assert_allclose(found.gains, gains, atol=1e-11)
    np.testing.assert_allclose(found.offsets, offsets, atol=1e-11)
    return found


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
def test_fit_is_the_least_squares_fit(dtype):
    render, truth = street()
    mask = ellipse(90, 160, slice(10, 80), slice(20, 150))
    scale = {"uint8": 255, "uint16": 65535}.get(dtype, 1.0)
    pair = [(image / 255 * scale).astype(dtype) for image in (render, truth)]
    assert check(*pair, scale=scale).db > psnr(render, truth) + 3
    check(*pair, mask, scale=scale)


def test_saturated_pixels_are_scored_but_not_fitted():
    render, truth = street()
    bright = np.clip(render.astype(int) + 70, 0, 255).astype(np.uint8)
    assert (bright == 255).any(axis=2).mean() > 0.05
    check(bright, truth)
    check(render, np.clip(truth.astype(int) - 60, 0, 255).astype(np.uint8))


def test_exposure_and_white_balance_are_undone():
    _, truth = street()
    small = (truth // 4 * 2 + 8).astype(np.uint8)
    render = np.stack([small[..., 0], small[..., 1] // 2 + 40, 250 - small[..., 2]], axis=2)
    assert psnr_affine(render[..., :2], small[..., :2]).db == math.inf
    negative = psnr_affine(render, small)
    assert negative.gains[2] == 0.0
    assert math.isfinite(negative.db)


def test_equal_images_are_infinite_and_an_empty_mask_has_no_score():
    _, truth = street()
    assert psnr_affine(truth, truth).db == math.inf
    assert psnr_affine(truth / 255.0, truth / 255.0, data_range=1.0).db == math.inf
    empty = psnr_affine(truth, truth, mask=np.zeros(truth.shape[:2], bool))
    assert math.isnan(empty.db)
    assert empty.db.reason


def test_constant_and_saturated_channels():
    _, truth = street()
    render = np.full_like(truth, 90)
    assert check(render, np.clip(truth, 1, 254)).gains == (0.0, 0.0, 0.0)
    render[..., 1] = 255
    found = check(render, truth)
    assert (found.gains[1], found.offsets[1]) == (1.0, 0.0)
    values = np.full((8, 8, 3), 1 / 3) * (1 + 1e-16)
    assert psnr_affine(values, np.clip(truth[:8, :8] / 255.0, 0.01, 0.99), data_range=1.0).gains == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_pixels_that_are_not_finite_are_an_error(bad):
    render, truth = (image / 255.0 for image in street(20, 20))
    render[4, 5, 2] = bad
    with pytest.raises(UsageError, match="row 4, column 5, channel 2"):
        psnr_affine(render, truth, data_range=1.0)
    mask = np.ones((20, 20), bool)
    mask[4, 5] = False
    assert math.isfinite(psnr_affine(render, truth, mask=mask, data_range=1.0).db)


def test_one_pixel_and_one_channel():
    assert psnr_affine(np.uint8([[[50, 60, 70]]]), np.uint8([[[80, 90, 100]]])).db == math.inf
    render, truth = street()
    assert psnr_affine(render[..., 0], truth[..., 0]).gains == psnr_affine(render, truth).gains[:1]


@settings(max_examples=draws(50), deadline=None)
@given(arrays(np.uint8, (2, 5, 7, 3)), arrays(np.bool_, (5, 7)))
def test_any_levels_agree_with_the_reference(images, mask):
    if mask.any():
        db, _, _ = affine_by_lstsq(images[0] / 255, images[1] / 255, mask)
        found = psnr_affine(images[0], images[1], mask=mask).db
        assert found == pytest.approx(db, abs=1e-7) or (math.isinf(found) and db > 170)


@settings(max_examples=draws(20), deadline=None)
@given(st.integers(0, 10_000), st.floats(0.3, 1.0), st.floats(0.0, 0.2))
def test_score_does_not_depend_on_the_exposure_of_the_render(seed, gain, offset):
    rng = np.random.default_rng(seed)
    render, truth = rng.uniform(0.1, 0.7, (2, 12, 12, 3))
    first = psnr_affine(render, truth, data_range=1.0)
    assert psnr_affine(gain * render + offset, truth, data_range=1.0).db == pytest.approx(first.db, abs=1e-6)


def test_scores_of_floats_do_not_depend_on_the_threads_of_blas():
    libraries = list((Path(np.__file__).parents[1] / "numpy.libs").glob("libscipy_openblas64_*"))
    if not libraries:
        pytest.skip("numpy does not bring its own OpenBLAS")
    set_threads = ctypes.CDLL(str(libraries[0])).scipy_openblas_set_num_threads64_
    render, truth = (image / 255 for image in street(180, 320))
    found = []
    for threads in (1, 2):
        set_threads(threads)
        found.append(psnr_affine(render, truth, data_range=1.0))
    set_threads(1)
    assert found[0] == found[1]


def test_batches_and_tensors_agree_with_arrays():
    render, truth = street()
    both = psnr_affine(np.stack([render, truth]), np.stack([truth, truth]), layout="nhwc")
    assert [one.db for one in both] == [psnr_affine(render, truth).db, math.inf]
    torch = pytest.importorskip("torch")
    images = [torch.from_numpy(image).permute(2, 0, 1) for image in (render, truth)]
    assert psnr_affine(*images, layout="chw") == psnr_affine(render, truth)
