"""What all three rivals do: learn, stop at the cap, go on after a checkpoint as if nothing had happened."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from mirror_baselines import mtgs_style, omnire_style, vanilla_3dgs
from tests.baselines_splatting.scenes import (
    GROWING,
    HEIGHT,
    SOURCES,
    WIDTH,
    initial,
    picture,
    pictures,
    small,
    viewpoint,
)

pytest.importorskip("gsplat", reason="gsplat is not installed: its strategy is what densifies")
METHODS = {"vanilla": vanilla_3dgs, "mtgs": mtgs_style, "omnire": omnire_style}
methods = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())


def _made(method, **changes):
    torch.set_num_threads(1)
    return method.make(initial(), small(method.RELEASED, **{"densification": GROWING, **changes}))


def _train(learner, shown, first, last, steps):
    return [learner.step(shown[k % len(shown)], k / steps) for k in range(first, last)]


@methods
def test_training_lowers_the_loss_and_grows_no_further_than_the_cap(method):
    learner, shown = _made(method, densification=replace(GROWING, resets=0)), pictures()
    begun = len(learner.model)
    reports = _train(learner, shown, 0, 60, 60)
    assert reports[-1].losses["rgb"] < 0.85 * reports[0].losses["rgb"]
    counts = [report.gaussians for report in reports]
    assert begun < max(counts) <= GROWING.most
    assert all(table.isfinite().all() for table in learner.model.tables.values())


@methods
def test_resuming_is_the_same_as_never_having_stopped(method):
    steps, half, shown = 40, 22, pictures()
    whole, first = _made(method), _made(method)
    _train(whole, shown, 0, steps, steps)
    _train(first, shown, 0, half, steps)
    kept = {name: tensor.clone() for name, tensor in first.state().items()}
    _train(first, shown, half, half + 3, steps)  # what was kept must not be shared
    second = _made(method)
    second.restore(kept)
    _train(second, shown, half, steps, steps)
    expected, found = whole.state(), second.state()
    assert expected.keys() == found.keys()
    assert all(torch.equal(expected[name], found[name]) for name in expected)
    at = viewpoint(0.7)
    assert torch.equal(whole.render(at).rgb, second.render(at).rgb)


@methods
def test_a_model_that_was_loaded_renders_as_the_one_that_learnt(method):
    from hybridworldsim.training.state import load

    learner, shown = _made(method), pictures()
    _train(learner, shown, 0, 30, 30)
    other = _made(method)
    load(other.model, learner.state())
    for at in (shown[0].viewpoint, viewpoint(0.7)):
        assert torch.equal(learner.render(at).rgb, other.render(at).rgb)


@methods
@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_one_flat_picture_is_learnt(method, value):
    learner, flat = _made(method), picture(value)
    reports = [learner.step(flat, k / 80) for k in range(80)]
    assert reports[-1].losses["rgb"] < max(0.3 * reports[0].losses["rgb"], 2e-3)
    assert learner.render(flat.viewpoint).rgb.isfinite().all()


@methods
def test_a_black_traversal_beside_another_is_trained_through(method):
    learner = _made(method)
    shown = [picture(0.0, viewpoint(0.1 * k, SOURCES[0])) for k in range(3)]
    shown += [picture(0.7, viewpoint(0.1 * k, SOURCES[1])) for k in range(3)]
    _train(learner, shown, 0, 60, 60)
    assert all(tensor.isfinite().all() for tensor in learner.state().values() if tensor.is_floating_point())


@methods
def test_a_picture_that_shows_nothing_changes_no_gaussian(method):
    learner = _made(method)
    away = viewpoint()
    away.viewmat[:3, 3] += torch.tensor([0.0, 0.0, -900.0])
    before = {name: table.detach().clone() for name, table in learner.model.tables.items()}
    learner.step(picture(0.3, away, None), 0.2)
    assert all(torch.equal(before[name], table) for name, table in learner.model.tables.items())


@methods
@pytest.mark.parametrize("settings", ["RELEASED", "TUNED"])
def test_settings_as_given_take_a_step(method, settings):
    learner = method.make(initial(), small(getattr(method, settings)))
    report = learner.step(pictures()[0], 0.5)
    assert all(value == value for value in report.losses.values())
    rendering = learner.render(viewpoint(0.3))
    assert rendering.rgb.shape == (HEIGHT, WIDTH, 3)
    assert rendering.counts["drawn"] <= rendering.counts["decoded"] <= rendering.counts["held"]


def test_of_a_tie_for_the_last_places_under_the_cap_none_is_let_in():
    learner = _made(vanilla_3dgs, densification=replace(GROWING, most=1, gradient=0.0))
    begun = len(learner.model)
    reports = _train(learner, pictures(), 0, 30, 30)
    assert max(report.gaussians for report in reports) <= begun
