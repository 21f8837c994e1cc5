"""A training step waits for the GPU twice at most: for how many Gaussians are opaque or visible, and for its losses."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
import torch

from hybridworldsim.model import street as street_module
from hybridworldsim.model.initialization import initial_street
from hybridworldsim.model.trainer import StreetTrainer
from mirror_baselines import mtgs_style, omnire_style, vanilla_3dgs
from mirror_baselines.splatting import renderer
from tests.baselines.splatting import scenes
from tests.training.shadow import DEVICE, WAITS, OnShadows, Shadow, rasterize_shadows, without_fused
from tests.training.street import SETTINGS, Painted, initial, views

MOST = 2
SPLATTING = {"vanilla": vanilla_3dgs, "mtgs": mtgs_style, "omnire": omnire_style}
IMAGES = [Painted()(one) for one in views()]


def street_trainer(structure: float = 0.1) -> StreetTrainer:
    """A street whose refinements lie beyond the steps of these tests; statistics are collected."""
    settings = replace(SETTINGS, structure_weight=structure, refinement=replace(SETTINGS.refinement, begin=0.5))
    return StreetTrainer(initial_street(initial(), settings), settings)


def splatting_trainer(method: Any) -> Any:
    pytest.importorskip("gsplat", reason="gsplat is not installed: its strategy is what densifies")
    settings = scenes.small(method.RELEASED, densification=replace(scenes.GROWING, begin=0.9, end=0.95))
    return method.make(scenes.initial(), settings)


def test_the_stand_in_sees_what_waits() -> None:
    with OnShadows():
        one = torch.arange(4.0, device=DEVICE)
        WAITS.clear()
        one + 1.0, one.sum(), one[torch.zeros(2, dtype=torch.int64, device=DEVICE)]
        torch.ones(3).to(DEVICE, non_blocking=True)
        assert isinstance(one, Shadow) and not WAITS
        float(one.sum()), one.nonzero(), one[one > 1.0], one.cpu(), one.tolist(), torch.ones(3).to(DEVICE)
        bool((one > 1.0).any())
    assert len(WAITS) >= 7


@pytest.mark.parametrize("name", ["street", *SPLATTING])
def test_a_step_waits_twice_at_most(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (street_module, renderer):
        monkeypatch.setattr(module, "rasterization", rasterize_shadows)
    monkeypatch.setattr(torch.optim, "Adam", without_fused(torch.optim.Adam))
    trainer = street_trainer() if name == "street" else splatting_trainer(SPLATTING[name])
    shown = IMAGES if name == "street" else scenes.images()
    with OnShadows():
        trainer = trainer.to(DEVICE)
        for step in range(5):
            image = shown[step % len(shown)]
            WAITS.clear()
            trainer.step(image, 0.01 * step)
            # The first step of an image adds its row of parameters.
            assert len(WAITS) <= MOST, (step, WAITS)
    assert WAITS.count("tolist") == 1


@contextmanager
def gsplat_may_wait(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """gsplat waits within its calls, for numbers of tiles; these are not counted."""
    import gsplat

    def silent(called: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            torch.cuda.set_sync_debug_mode("default")
            try:
                return called(*args, **options)
            finally:
                torch.cuda.set_sync_debug_mode("warn")

        return call

    monkeypatch.setattr(gsplat, "rasterization", silent(gsplat.rasterization))
    yield
    torch.cuda.set_sync_debug_mode("default")


@pytest.mark.cuda(splats=True)
@pytest.mark.parametrize("name", ["street", *SPLATTING])
def test_a_step_on_a_gpu_waits_twice_at_most(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = street_trainer() if name == "street" else splatting_trainer(SPLATTING[name])
    shown = IMAGES if name == "street" else scenes.images()
    trainer = trainer.to("cuda:0")
    for step in range(3):
        trainer.step(shown[step % len(shown)], 0.01 * step)
    with gsplat_may_wait(monkeypatch), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        trainer.step(shown[0], 0.05)
    assert sum("synchroniz" in str(one.message).lower() for one in caught) <= MOST
