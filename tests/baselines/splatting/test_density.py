"""gsplat's strategy, driven by progress."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from mirror_baselines import vanilla_3dgs
from tests.baselines.splatting.scenes import GROWING, images, initial, small

pytest.importorskip("gsplat", reason="gsplat is not installed: its strategy is what densifies")


def _rounds(steps, monkeypatch, **changes):
    """Progress at each round and at each reset of opacities, for a number of steps."""
    settings = replace(GROWING, **changes)
    trainer = vanilla_3dgs.make(initial(), small(vanilla_3dgs.RELEASED, densification=settings))
    density, rounds, resets = trainer.density, [], []
    after = density.after_backward
    monkeypatch.setattr("mirror_baselines.splatting.density.reset_opa", lambda *_: resets.append(None))

    def watched(tables, optimizers, meta, progress):
        before = len(resets)
        if after(tables, optimizers, meta, progress):
            rounds.append(progress)
        if len(resets) > before:
            resets[-1] = progress
        return rounds[-1:] == [progress]

    monkeypatch.setattr(density, "after_backward", watched)
    shown = images(2)
    for step in range(steps):
        trainer.step(shown[step % 2], step / steps)
    return rounds, resets


@pytest.mark.parametrize("steps", [40, 90])
def test_rounds_and_resets_depend_on_progress_only(steps, monkeypatch):
    rounds, resets = _rounds(steps, monkeypatch, begin=0.1, end=0.7, rounds=6, resets=2)
    expected = torch.linspace(0.2, 0.7, 6)
    torch.testing.assert_close(torch.tensor(rounds), expected, rtol=0, atol=1.0 / steps + 1e-6)
    # There is no reset at the end of densification, because no round would follow it.
    torch.testing.assert_close(torch.tensor(resets), torch.tensor([0.4]), rtol=0, atol=1.0 / steps + 1e-6)


def test_rounds_within_one_step_are_merged(monkeypatch):
    rounds, _ = _rounds(4, monkeypatch, begin=0.1, end=0.7, rounds=60)
    assert rounds == [0.25, 0.5, 0.75]


def test_transparent_gaussians_are_removed():
    trainer = vanilla_3dgs.make(initial(), small(vanilla_3dgs.RELEASED, densification=replace(GROWING, gradient=1e9)))
    with torch.no_grad():
        trainer.model.tables["opacities"][:10] = -9.0
    begun, shown = len(trainer.model), images(2)
    for step in range(20):
        report = trainer.step(shown[step % 2], step / 40)
    assert report.gaussians == begun - 10
