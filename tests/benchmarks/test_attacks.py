"""The attack suite: changes keep their form, the filter search finds a gain, finished scores are kept by hash."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.attacks.benchmark import (
    BEST_FILTER,
    FLOOR,
    HONEST,
    KEY,
    TrueView,
    attack_row,
    find_gap,
    format_tables,
    largest_gains,
    main,
)
from benchmarks.attacks.changes import CHANGES, NOTHING, Material, blur, to_levels
from benchmarks.attacks.filters import apply_filter, find_filter
from mirror.errors import UsageError
from mirror.metrics.images.psnr import psnr
from mirror.protocols.views.view import RenderView
from tests.metrics.images.references import street


def make_view(seed: int) -> tuple[TrueView, np.ndarray]:
    render, truth = street(48, 72, seed)
    nearest = np.roll(truth, 5, axis=1)
    view = RenderView.model_construct(path=f"{seed}.png", group="novel")
    return TrueView(
        view, truth, np.ones(truth.shape[:2], bool), nearest, to_levels(blur(nearest.astype(float), 9.0))
    ), render


@pytest.mark.parametrize("name", [*CHANGES, *NOTHING])
def test_changes_are_images_and_leave_the_render_alone(name: str) -> None:
    one, render = make_view(0)
    kept = render.copy()
    changed = {**CHANGES, **NOTHING}[name](Material(render, one.nearest, one.mean))
    assert (changed.shape, changed.dtype) == (render.shape, np.uint8)
    assert np.array_equal(render, kept)
    assert not np.array_equal(changed, render)


def test_search_finds_a_filter_that_gains() -> None:
    """Noise on a smooth truth: the best filter in PSNR is a blur."""
    rng = np.random.default_rng(0)
    truth = to_levels(blur(rng.uniform(0, 255, (40, 60, 3)), 4.0) * 4 - 380)
    noisy = to_levels(truth + rng.normal(0, 20, truth.shape))
    shares = find_filter([noisy], lambda _, image: float(psnr(image, truth)))
    assert psnr(apply_filter(noisy, shares), truth) > psnr(noisy, truth) + 6
    assert np.array_equal(apply_filter(noisy, 0 * shares), noisy)


def test_scores_are_kept_by_the_hash_of_their_inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    views, renders = zip(*(make_view(seed) for seed in range(2)))
    found = attack_row(views, renders, tmp_path)
    assert set(found) == {HONEST, BEST_FILTER, *CHANGES}
    (file,) = tmp_path.iterdir()
    before = file.stat().st_mtime_ns
    assert attack_row(views, renders, tmp_path) == found
    assert file.stat().st_mtime_ns == before
    attack_row(views, [renders[0], 255 - renders[1]], tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def test_gains_are_parts_of_the_gap_between_trained_rows() -> None:
    rows = {
        "best": {HONEST: {KEY: 0.4, "psnr_invariant": 30.0}, "blur": {KEY: 0.41, "psnr_invariant": 30.4}},
        "worst": {HONEST: {KEY: 0.2, "psnr_invariant": 28.0}, "blur": {KEY: 0.18, "psnr_invariant": 28.2}},
        FLOOR: {HONEST: {KEY: 0.1, "psnr_invariant": 27.0}, "blur": {KEY: 0.12, "psnr_invariant": 28.4}},
    }
    assert find_gap(rows, KEY) == pytest.approx(0.2)
    assert largest_gains(rows) == pytest.approx({"best": 0.05, "worst": 0.0, FLOOR: 0.1})
    text = format_tables(rows, {"grey": {KEY: 0.0, "psnr_invariant": 27.5}})
    assert "| grey | 27.50 | 0.0000 |" in text
    assert "| blur | +20.0 | +70.0 | +5.0 | +10.0 |" in text


def test_a_row_needs_its_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="NAME=SUBMISSION"):
        main([str(tmp_path), f"mine={tmp_path / 'none'}"])
