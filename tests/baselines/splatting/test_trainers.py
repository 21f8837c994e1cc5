"""All three baselines: training, the cap, and exact resumption from a checkpoint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hybridworldsim.methods.overrides import settings_document
from hybridworldsim.methods.renderers import OpenBlock, one_point, open_block, render_nearest, training_sources
from hybridworldsim.rasterizer import rasterization
from hybridworldsim.training.appearance import trained_cameras
from hybridworldsim.training.documents import Run
from hybridworldsim.training.parameters import write_parameters
from hybridworldsim.training.run.folder import MODEL
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.capabilities import Capabilities, find_capabilities
from mirror.schema.files import write_json
from mirror_baselines import mtgs_style, omnire_style, vanilla_3dgs
from tests.baselines.splatting.scenes import (
    GROWING,
    HEIGHT,
    SOURCES,
    WIDTH,
    image,
    images,
    initial,
    small,
    viewpoint,
)
from tests.rasterizer.covers import assert_covers_are
from tests.training import street

pytest.importorskip("gsplat", reason="gsplat is not installed: its strategy is what densifies")
METHODS = {"vanilla": vanilla_3dgs, "mtgs": mtgs_style, "omnire": omnire_style}
methods = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())


def _made(method, **changes):
    torch.set_num_threads(1)
    return method.make(initial(), small(method.RELEASED, **{"densification": GROWING, **changes}))


def _train(trainer, shown, first, last, steps):
    return [trainer.step(shown[k % len(shown)], k / steps) for k in range(first, last)]


@methods
def test_training_lowers_the_loss_within_the_cap(method):
    trainer, shown = _made(method, densification=replace(GROWING, resets=0)), images()
    begun = len(trainer.model)
    reports = _train(trainer, shown, 0, 60, 60)
    assert reports[-1].losses["rgb"] < 0.85 * reports[0].losses["rgb"]
    counts = [report.gaussians for report in reports]
    assert begun < max(counts) <= GROWING.most
    assert all(table.isfinite().all() for table in trainer.model.tables.values())


@methods
def test_resumed_training_is_identical(method):
    steps, half, shown = 40, 22, images()
    whole, first = _made(method), _made(method)
    _train(whole, shown, 0, steps, steps)
    _train(first, shown, 0, half, steps)
    kept = {name: tensor.clone() for name, tensor in first.state().items()}
    _train(first, shown, half, half + 3, steps)  # the stored state must not share memory
    second = _made(method)
    second.restore(kept)
    _train(second, shown, half, steps, steps)
    expected, found = whole.state(), second.state()
    assert expected.keys() == found.keys()
    assert all(torch.equal(expected[name], found[name]) for name in expected)
    at = viewpoint(0.7)
    assert torch.equal(whole.render(at).rgb, second.render(at).rgb)


@methods
def test_loaded_model_renders_as_the_trained_one(method):
    from hybridworldsim.training.run.state import load

    trainer, shown = _made(method), images()
    _train(trainer, shown, 0, 30, 30)
    other = _made(method)
    load(other.model, trainer.state())
    for at in (shown[0].viewpoint, viewpoint(0.7)):
        assert torch.equal(trainer.render(at).rgb, other.render(at).rgb)


@methods
def test_covers_are_the_opacity_of_what_lies_before_a_far_plane(method):
    trainer, limits = _made(method), (5.0, 8.5, 30.0)
    _train(trainer, images(), 0, 10, 10)
    covers = []
    geometry, at = trainer.model.geometry(torch.arange(len(trainer.model))), viewpoint()
    for limit in limits:
        rendering, cover = trainer.render_covers(viewpoint(), np.full((HEIGHT, WIDTH), limit, np.float32))
        assert torch.equal(rendering.rgb, trainer.render(viewpoint()).rgb)
        _, alphas, _ = rasterization(
            geometry["means"], geometry["quats"], geometry["scales"].exp(), geometry["opacities"].sigmoid(),
            torch.zeros(len(trainer.model), 3), at.viewmat[None], at.K[None], WIDTH, HEIGHT,
            near_plane=trainer.settings.near_m, far_plane=limit,
            rasterize_mode="antialiased" if trainer.settings.antialiased else "classic",
        )  # fmt: skip
        assert_covers_are(cover, alphas[0, ..., 0].detach())
        covers.append(cover.mean())
    assert torch.stack(covers).diff().min() > 0.01


def _run(settings=None):
    return Run(
        method="any", settings={} if settings is None else settings_document(settings), settings_hash="", seed=0,
        steps=1, core_minutes=None, threads=1, scene="s", split="novel", block="whole", origin_m=(0.0, 0.0, 0.0),
        radius_m=30.0, width_px=WIDTH, half=False, dataset_hash="", plan_hash="", depth=None, points=None, pictures=1,
        sources=trained_cameras(street.views()) if settings is None else [_trained(source) for source in SOURCES],
    )  # fmt: skip


def _trained(source):
    return trained_cameras(street.views())[0].model_copy(update=source._asdict())


@methods
def test_a_trained_block_is_opened_without_a_geometry(method, tmp_path):
    trainer, shown = _made(method), images()
    _train(trainer, shown, 0, 30, 30)
    write_parameters(tmp_path / MODEL, trainer.model, half=False)
    write_json(tmp_path / "run.json", _run(trainer.settings))

    def make_empty(run, settings):
        return method.make_empty(training_sources(run), settings)

    def make_at_one_point(run, settings):
        return method.make(one_point(run), settings)

    for make in (make_empty, make_at_one_point):
        opened = open_block(tmp_path, make, type(trainer.settings)).model
        assert hasattr(opened, "density") is not (make is make_empty)
        for at in (shown[0].viewpoint, viewpoint(0.7)):
            assert torch.equal(trainer.render(at).rgb, opened.render(at).rgb)


def test_a_renderer_states_covers_if_its_method_does():
    for trainer, expected in ((_made(vanilla_3dgs), True), (street.trainer(), False)):
        shown = find_capabilities(object(), trainer)
        assert shown == Capabilities(renders_depth=True, renders_covers=expected)
        renderer = render_nearest([OpenBlock(_run(), trainer)], AppearancePolicy(), shown)
        assert find_capabilities(object(), renderer) == shown


@methods
@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_a_constant_image_is_learned(method, value):
    trainer, flat = _made(method), image(value)
    reports = [trainer.step(flat, k / 80) for k in range(80)]
    assert reports[-1].losses["rgb"] < max(0.3 * reports[0].losses["rgb"], 2e-3)
    assert trainer.render(flat.viewpoint).rgb.isfinite().all()


@methods
def test_training_survives_a_black_traversal(method):
    trainer = _made(method)
    shown = [image(0.0, viewpoint(0.1 * k, SOURCES[0])) for k in range(3)]
    shown += [image(0.7, viewpoint(0.1 * k, SOURCES[1])) for k in range(3)]
    _train(trainer, shown, 0, 60, 60)
    assert all(tensor.isfinite().all() for tensor in trainer.state().values() if tensor.is_floating_point())


@methods
def test_an_image_without_gaussians_changes_no_gaussian(method):
    trainer = _made(method)
    away = viewpoint()
    away.viewmat[:3, 3] += torch.tensor([0.0, 0.0, -900.0])
    before = {name: table.detach().clone() for name, table in trainer.model.tables.items()}
    trainer.step(image(0.3, away, None), 0.2)
    assert all(torch.equal(before[name], table) for name, table in trainer.model.tables.items())


@methods
@pytest.mark.parametrize("settings", ["RELEASED", "TUNED"])
def test_every_preset_can_take_a_step(method, settings):
    trainer = method.make(initial(), small(getattr(method, settings)))
    report = trainer.step(images()[0], 0.5)
    assert all(value == value for value in report.losses.values())
    rendering = trainer.render(viewpoint(0.3))
    assert rendering.rgb.shape == (HEIGHT, WIDTH, 3)
    assert rendering.counts["drawn"] <= rendering.counts["decoded"] <= rendering.counts["held"]


def test_ties_at_the_cap_add_no_gaussian():
    trainer = _made(vanilla_3dgs, densification=replace(GROWING, most=1, gradient=0.0))
    begun = len(trainer.model)
    reports = _train(trainer, images(), 0, 30, 30)
    assert max(report.gaussians for report in reports) <= begun
