"""A street that is trained by plain torch, or with dense Adam, as on a GPU, ends as one that is trained on the CPU."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch

from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.model import street as street_module
from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition
from hybridworldsim.model.initialization import initial_street
from hybridworldsim.model.losses import colour_loss
from hybridworldsim.model.settings import Settings
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.training.block_training import psnr_db
from hybridworldsim.training.previews import pixels
from tests.model.streets import SOURCES
from tests.model.streets import street as block_street
from tests.model.streets import view as street_view
from tests.training.shadow import DEVICE, OnShadows, rasterize_shadows, without_fused
from tests.training.street import SETTINGS, Painted, initial, views

STEPS = 200
IMAGES = [Painted()(one) for one in views()]


def trained(
    settings: Settings, steps: int, form: Callable[[], AbstractContextManager[None]] = nullcontext, dense: bool = False
) -> StreetTrainer:
    trainer = StreetTrainer(initial_street(initial(), settings), settings, dense=dense)
    with form():
        for step in range(steps):
            trainer.step(IMAGES[7 * step % len(IMAGES)], step / steps)
    return trainer


def mean_psnr_db(trainer: StreetTrainer) -> float:
    errors = [colour_loss(trainer.render(one.viewpoint).rgb, one.rgb, one.scored) for one in IMAGES]
    return float(np.mean([psnr_db(float(error)) for error in errors]))


def test_training_by_plain_torch_ends_as_by_the_kernels() -> None:
    """All losses, and three refinements. Measured with three seeds: 0.01, 0.02 and 0.03 dB."""
    settings = replace(SETTINGS, structure_weight=0.1)
    kernels, plain = trained(settings, STEPS), trained(settings, STEPS, plain_torch)
    assert len(kernels.street.background) == len(plain.street.background) > 300
    assert mean_psnr_db(kernels) > 28.0
    assert mean_psnr_db(plain) == pytest.approx(mean_psnr_db(kernels), abs=0.1)


def test_dense_adam_ends_as_lazy_adam() -> None:
    """Without refinements, which choose other anchors after the smallest difference. Measured: 0.01 dB at most."""
    settings = replace(SETTINGS, refinement=replace(SETTINGS.refinement, begin=0.995, end=1.0))
    dense, lazy = trained(settings, STEPS // 2, dense=True), trained(settings, STEPS // 2)
    assert mean_psnr_db(dense) == pytest.approx(mean_psnr_db(lazy), abs=0.05)


def test_statistics_of_refinement_count_the_anchors_in_view_where_all_are_decoded() -> None:
    """As on the CPU, which decodes those in view only: visits, opacities, distances and gradients."""
    narrow = torch.tensor([[80.0, 0.0, 16.0], [0.0, 80.0, 10.0], [0.0, 0.0, 1.0]])
    shown = replace(IMAGES[0], viewpoint=replace(IMAGES[0].viewpoint, K=narrow))
    found = []
    for dense in (False, True):
        trainer = StreetTrainer(initial_street(initial(), SETTINGS), SETTINGS, dense=dense)
        trainer.step(shown, 0.0)
        found.append(trainer._anchors.state())
    lazy, dense_state = found
    assert 0.05 < float(lazy["seen"].mean()) < 0.95, "some anchors are not in view"
    for name, expected in lazy.items():
        torch.testing.assert_close(dense_state[name], expected, rtol=1e-4, atol=1e-6)


def test_a_restored_dense_training_continues_exactly() -> None:
    settings = replace(SETTINGS, refinement=replace(SETTINGS.refinement, least_steps=4))
    whole = trained(settings, 24, dense=True)
    first = StreetTrainer(initial_street(initial(), settings), settings, dense=True)
    for step in range(24):
        if step == 14:
            state = {name: tensor.clone() for name, tensor in first.state().items()}
            first = StreetTrainer(initial_street(initial(), settings), settings, dense=True)
            first.restore(state)
        first.step(IMAGES[7 * step % len(IMAGES)], step / 24)
    for (name, one), (_, other) in zip(whole.street.named_parameters(), first.street.named_parameters(), strict=True):
        assert torch.equal(one, other), name


def test_a_street_is_trained_and_rendered_on_a_device_without_mixing_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers on a stand-in for a GPU; refinements included. They end as on the CPU, in plain torch with dense Adam."""
    monkeypatch.setattr(street_module, "rasterization", rasterize_shadows)
    monkeypatch.setattr(torch.optim, "Adam", without_fused(torch.optim.Adam))
    settings = replace(SETTINGS, structure_weight=0.1, refinement=replace(SETTINGS.refinement, least_steps=4))
    elsewhere = StreetTrainer(initial_street(initial(), settings), settings)
    with OnShadows():
        elsewhere = elsewhere.to(DEVICE)
        for step in range(24):
            elsewhere.step(IMAGES[7 * step % len(IMAGES)], step / 24)
        state = {name: tensor.cpu() for name, tensor in elsewhere.state().items()}
        elsewhere.restore(state)
        elsewhere.step(IMAGES[0], 1.0)
        rendered = elsewhere.render(IMAGES[0].viewpoint)
        image = pixels(rendered.rgb)
    assert rendered.rgb.device.type == DEVICE
    assert {one.device.type for one in elsewhere.street.parameters()} == {DEVICE}
    assert len(elsewhere.street.background) > 300
    assert np.abs(image - 255.0 * IMAGES[0].rgb.numpy()).mean() < 40.0


def test_composed_blocks_render_on_a_device_as_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two blocks that overlap, seen from between them: weights and cross-fades are on the device too."""
    blocks = [Block((0, 0), (0.0, 0.0, 0.0), 60.0, 15.0), Block((1, 0), (45.0, 0.0, 0.0), 60.0, 15.0)]
    seen = street_view(22.0)

    def compose(device: str) -> Composition:
        streets = (block_street(seed=4), block_street(seed=5))
        return Composition(list(zip(blocks, streets)), device)

    def select(latents: AppearanceLatents) -> tuple[torch.Tensor, torch.Tensor]:
        return latents(SOURCES[0]), latents(SOURCES[1])

    expected, counts = compose("cpu").render(seen, select)
    monkeypatch.setattr(street_module, "rasterization", rasterize_shadows)
    with OnShadows():
        # The inference mode of torch knows no stand-ins.
        elsewhere = compose(DEVICE)
        with torch.no_grad():
            decoded = Composition.decode.__wrapped__(elsewhere, seen, select)
            found = Composition.draw.__wrapped__(elsewhere, seen, decoded)
        rgb = found.rgb.cpu()
    assert found.rgb.device.type == DEVICE and counts["blocks"] == 2
    assert sum(map(len, decoded.splats)) == counts["drawn"]
    torch.testing.assert_close(rgb, expected.rgb, rtol=1e-4, atol=1e-4)
