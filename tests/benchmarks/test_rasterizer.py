"""What the rasterizer's benchmark measures, on tiny pictures."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from benchmarks import _splat_errors, _splat_scenes, _splat_views, rasterizer
from benchmarks._splat_views import View, count_name, with_threads


@pytest.fixture(autouse=True)
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(_splat_errors, "OUT", tmp_path)
    return tmp_path


@pytest.fixture
def view() -> View:
    return View(_splat_scenes.random(300), 40, 30)


def test_errors_are_those_of_rounding(view: View) -> None:
    true = _splat_errors.truth(view, gradients=True)
    errors = _splat_errors.picture_errors(view, true)
    assert 0 < errors.unmarked < 2e-5
    assert errors.beyond_flips < 2e-5
    assert all(found.norm < 2e-5 for found in _splat_errors.gradient_errors(view, true).values())


def test_an_error_is_seen(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    true = _splat_errors.truth(view, gradients=True)
    rendered = View.render

    def wrong(self: View, tensors, backend="cpu"):
        picture, alphas, meta = rendered(self, tensors, backend)
        return picture * 1.01, alphas, meta

    monkeypatch.setattr(View, "render", wrong)
    assert _splat_errors.picture_errors(view, true).unmarked == pytest.approx(0.01 * true.picture.max().item(), rel=0.1)
    assert _splat_errors.gradient_errors(view, true)["colors"].norm == pytest.approx(0.01, rel=0.01)


def test_the_reference_renders_a_view_once(view: View, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = _splat_errors.truth(view, gradients=True)
    assert len(list(out.rglob("*.pt"))) == 1
    monkeypatch.setattr(_splat_errors, "_rendered", pytest.fail)
    again = _splat_errors.truth(view, gradients=True)
    torch.testing.assert_close(first.picture, again.picture, rtol=0, atol=0)
    assert first.gradients.keys() == again.gradients.keys()


def test_times_and_threads(view: View) -> None:
    before = torch.get_num_threads()
    with with_threads(1):
        assert torch.get_num_threads() == 1
        assert _splat_views.forward_ms(view, 1) > 0
        assert min(_splat_views.both_ms(view, 1)) > 0
    assert torch.get_num_threads() == before


def test_sizes_are_read_easily() -> None:
    assert [count_name(count) for count in (10_000, 1_000_000, 3_000_000)] == ["10 k", "1 M", "3 M"]


def test_every_bar_is_measured() -> None:
    measured = {(name, count) for name, count, width, _ in rasterizer._timed_views(quick=False) if width == 960}
    assert set(rasterizer.FORWARD_BARS) <= measured
