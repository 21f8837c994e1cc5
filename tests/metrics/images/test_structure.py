"""`ms_structure` and `matched_structure` against their definitions in dense float64 sums, and renders of nothing."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.metrics.images.matched_structure import matched_structure
from mirror.metrics.images.structure import NO_STRUCTURE, ms_structure
from tests.draws import draws
from tests.metrics.images.references import ellipse, street

WEIGHTS = np.array([0.299, 0.587, 0.114])


def window_matrix(size: int, sigma: float) -> np.ndarray:
    """The weights (size, size) of a gaussian window of three deviations at each place of an axis."""
    offsets = np.arange(size)[:, None] - np.arange(size)
    reach = math.ceil(3 * sigma)
    weights = np.where(np.abs(offsets) <= reach, np.exp(-0.5 * offsets**2 / sigma**2), 0.0)
    return weights / np.exp(-0.5 * np.arange(-reach, reach + 1) ** 2 / sigma**2).sum()


def by_definition(metric: object, render: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """The definition, with every window as a dense sum over selected pixels; images in [0, 1]."""
    is_matched = metric is matched_structure
    shown = [render @ WEIGHTS, *np.moveaxis(render, 2, 0)]
    if is_matched:
        shown += [np.log(x + 0.02) for x in shown]
    return max(of_values(x, truth @ WEIGHTS, mask, is_matched) for x in shown)


def of_values(x: np.ndarray, y: np.ndarray, mask: np.ndarray, is_matched: bool) -> float:
    """The score of luma or of one channel of a render, or of the logarithm of one."""
    known = mask.astype(float)
    scores = []
    for scale in range(4):
        if scale:
            rows, columns = known.shape[0] // 2, known.shape[1] // 2
            parts = [image[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2) for image in (x, y, known)]
            x, y, known = parts[0].mean((1, 3)), parts[1].mean((1, 3)), parts[2].min((1, 3))

        def mean(image: np.ndarray, sigma: float, known: np.ndarray = known) -> np.ndarray:
            down, across = (window_matrix(size, sigma) for size in known.shape)
            total = down @ known @ across.T
            return down @ (known * image) @ across.T / np.where(total > 0, total, 1.0)

        fine = [mean(image, 0.7) if is_matched else image for image in (x, y)]
        a, b = fine[0] - mean(x, 2.0), fine[1] - mean(y, 2.0)
        aa, bb, ab = mean(a * a, 3.0), mean(b * b, 3.0), mean(a * b, 3.0)
        rounding = 1 / (12 * 255**2)
        r = ab / np.sqrt((aa + rounding) * (bb + rounding))
        weights = known * np.where(bb > rounding, bb / (bb + 0.02**2), 0.0)
        if weights.sum() > 0:
            gain = np.maximum(r * abs(r) - 0.6, 0.0) / 0.4 if is_matched else r * abs(r)
            scores.append((weights * gain).sum() / weights.sum())
    return float(np.mean(scores))


@pytest.mark.parametrize("metric", [ms_structure, matched_structure])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
def test_score_follows_its_definition(metric: Callable[..., float], dtype: str) -> None:
    scale = {"uint8": 255, "uint16": 65535}.get(dtype, 1.0)
    render, truth = ((image / 255 * scale).astype(dtype) for image in street(61, 83))
    mask = ellipse(61, 83, slice(5, 58), slice(9, 80))
    for used in (np.ones((61, 83), bool), mask):
        expected = by_definition(metric, render / np.float64(scale), truth / np.float64(scale), used)
        found = metric(render, truth, mask=used, data_range=scale if scale == 1.0 else None)
        assert found == pytest.approx(expected, abs=1e-6 if dtype == "float32" else 1e-11)


def test_equal_images_explain_everything() -> None:
    _, truth = street()
    assert 0.99 < ms_structure(truth, truth) <= 1.0
    inverted = np.repeat(np.rint(255 - truth @ WEIGHTS).astype(np.uint8)[..., None], 3, axis=2)
    assert -1.0 <= ms_structure(inverted, truth) < -0.98


def test_a_power_of_the_brightness_gains_little() -> None:
    render, truth = street()
    honest = matched_structure(render, truth)
    assert 0.1 < honest < 0.9
    for power in (0.6, 1.5):
        changed = np.rint(255 * (render / 255.0) ** power).astype(np.uint8)
        assert matched_structure(changed, truth) - honest < 0.005
    assert 0.95 < matched_structure(truth, truth) <= 1.0
    assert matched_structure(255 - truth, truth) == 0.0


def test_nothing_shown_scores_nothing() -> None:
    _, truth = street()
    y = np.mgrid[:90, :160][0]
    flat = np.full_like(truth, 128)
    ramp = np.repeat((y * 2.0).astype(np.uint8)[..., None], 3, axis=2)
    noise = np.random.default_rng(0).integers(0, 256, truth.shape, dtype=np.uint8)
    assert ms_structure(flat, truth) == pytest.approx(0.0, abs=1e-12)
    assert abs(ms_structure(ramp, truth)) < 0.02
    assert abs(ms_structure(noise, truth)) < 0.05
    for nothing in (flat, ramp, noise):
        assert 0.0 <= matched_structure(nothing, truth) < 0.005


@settings(max_examples=draws(25), deadline=None)
@given(st.integers(0, 10_000))
def test_exposure_and_pixels_outside_the_mask_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    render, truth = (image / 255.0 for image in street(40, 56, seed))
    mask = rng.random((40, 56)) < 0.7
    expected = ms_structure(render, truth, mask=mask, data_range=1.0)
    changed = rng.uniform(1.0, 2.0) * render + rng.uniform(-1.0, 1.0)
    changed[~mask] = math.nan
    assert ms_structure(changed, truth, mask=mask, data_range=1.0) == pytest.approx(expected, abs=3e-3)
    assert ms_structure(np.where(mask[..., None], render, 9.0), truth, mask=mask, data_range=1.0) == expected


def test_degenerate_images() -> None:
    render, truth = street(40, 56)
    for image in (np.full_like(truth, 255), np.zeros_like(truth)):
        unknown = ms_structure(render, image)
        assert math.isnan(unknown) and unknown.reason == NO_STRUCTURE
        assert ms_structure(image, truth) == pytest.approx(0.0, abs=1e-12)
    assert math.isnan(ms_structure(np.uint8([[[1, 2, 3]]]), np.uint8([[[3, 2, 9]]])))
    assert math.isfinite(ms_structure(render[:2, :3], truth[:2, :3]))
    empty = ms_structure(render, truth, mask=np.zeros((40, 56), bool))
    assert math.isnan(empty) and empty.reason is not None
    offset = [image / 255.0 + 1e6 for image in (render, truth)]
    expected = ms_structure(render / 255.0, truth / 255.0, data_range=1.0)
    assert ms_structure(*offset, data_range=1.0) == pytest.approx(expected, abs=1e-6)


def test_wrong_images_are_refused() -> None:
    render, truth = (image / 255.0 for image in street(40, 56))
    render[3, 4, 1] = math.inf
    with pytest.raises(UsageError, match="row 3, column 4"):
        ms_structure(render, truth, data_range=1.0)
    with pytest.raises(UsageError, match="2 channels"):
        ms_structure(truth[..., :2], truth[..., :2], data_range=1.0)


def test_batches_and_layouts_have_the_scores_of_images() -> None:
    render, truth = street(40, 56)
    expected = ms_structure(render, truth)
    assert ms_structure(np.stack([render, truth]), np.stack([truth, truth]), layout="nhwc")[0] == expected
    images = [np.ascontiguousarray(np.moveaxis(image, 2, 0)) for image in (render, truth)]
    assert ms_structure(*images, layout="chw") == expected
    grey = [np.rint(image @ WEIGHTS).astype(np.uint8) for image in (render, truth)]
    assert ms_structure(*grey) <= expected + 0.01


def test_sending_one_channel_in_all_gains_nothing() -> None:
    render, truth = street()
    honest = ms_structure(render, truth)
    for channel in range(3):
        assert ms_structure(np.repeat(render[..., channel : channel + 1], 3, axis=2), truth) <= honest + 1e-12
