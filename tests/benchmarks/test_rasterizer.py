"""Errors and times of the rasterizer's benchmark, on tiny images."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from benchmarks.rasterizer import benchmark, errors, scenes, views
from benchmarks.rasterizer.views import View, count_name, with_threads


@pytest.fixture(autouse=True)
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(errors, "OUT", tmp_path)
    return tmp_path


@pytest.fixture
def view() -> View:
    return View(scenes.random(300), 40, 30)


def test_errors_are_rounding_errors(view: View) -> None:
    true = errors.truth(view, gradients=True)
    found = errors.compute_image_errors(view, true)
    assert 0 < found.unmarked < 2e-5
    assert found.beyond_flips < 2e-5
    assert all(one.norm < 2e-5 for one in errors.compute_gradient_errors(view, true).values())


def test_a_wrong_render_has_an_error(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    true = errors.truth(view, gradients=True)
    rendered = View.render

    def wrong(self: View, tensors, backend="cpu"):
        image, alphas, meta = rendered(self, tensors, backend)
        return image * 1.01, alphas, meta

    monkeypatch.setattr(View, "render", wrong)
    assert errors.compute_image_errors(view, true).unmarked == pytest.approx(0.01 * true.image.max().item(), rel=0.1)
    assert errors.compute_gradient_errors(view, true)["colors"].norm == pytest.approx(0.01, rel=0.01)


def test_the_reference_renders_a_view_once(view: View, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = errors.truth(view, gradients=True)
    assert len(list(out.rglob("*.pt"))) == 1
    monkeypatch.setattr(errors, "render_truth", pytest.fail)
    again = errors.truth(view, gradients=True)
    torch.testing.assert_close(first.image, again.image, rtol=0, atol=0)
    assert first.gradients.keys() == again.gradients.keys()


def test_times_and_threads(view: View) -> None:
    before = torch.get_num_threads()
    with with_threads(1):
        assert torch.get_num_threads() == 1
        assert views.forward_ms(view, 1) > 0
        assert min(views.both_ms(view, 1)) > 0
    assert torch.get_num_threads() == before


def test_sizes_are_formatted() -> None:
    assert [count_name(count) for count in (10_000, 1_000_000, 3_000_000)] == ["10 k", "1 M", "3 M"]


def test_every_bar_is_measured() -> None:
    measured = {(name, count) for name, count, width, _ in benchmark.timed_views(quick=False) if width == 960}
    assert set(benchmark.FORWARD_BARS) <= measured
