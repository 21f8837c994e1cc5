"""Adds and removes Gaussians by gsplat's `DefaultStrategy`, in rounds of progress instead of steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from gsplat import DefaultStrategy
from gsplat.strategy.ops import reset_opa
from torch import Tensor, nn
from torch.optim import Optimizer

from mirror_baselines.splatting.settings import Densification

_STATISTICS = ("grad2d", "count")


class DensityControl:
    """gsplat's strategy with a schedule of rounds, a cap and a seed.

    The strategy reads step numbers. Here each round has two: the even one, at which it refines, and the odd one, which
    stands for all steps until the next round. The cap rises from round to round; it is kept by raising the gradient
    threshold for growth, so that the Gaussians with the largest gradients grow. Scenes are in metres, hence the
    strategy's scene scale is 1.

    Args:
        settings: schedule and thresholds.
        seed: seed of the positions of split Gaussians.
        initial_count: initial number of Gaussians.
    """

    def __init__(self, settings: Densification, seed: int, initial_count: int) -> None:
        self.settings, self._seed = settings, seed
        self._initial_count, self._max_count = initial_count, max(settings.most, initial_count)
        self._rounds_per_reset = max(settings.rounds // max(settings.resets, 1), 1)
        self._strategy = DefaultStrategy(
            prune_opa=settings.least_opacity,
            grow_grad2d=settings.gradient,
            grow_scale3d=settings.split_m,
            prune_scale3d=float("inf") if settings.largest_m is None else settings.largest_m,
            refine_start_iter=0,
            refine_stop_iter=2 * settings.rounds + 1,
            refine_every=2,
            reset_every=2 * self._rounds_per_reset,
            absgrad=settings.absolute,
        )
        self._state: dict[str, Any] = self._strategy.initialize_state(scene_scale=1.0)
        self._round, self._reset = 0, 0

    @property
    def is_active(self) -> bool:
        """Return whether image gradients are still needed."""
        return self._round < self.settings.rounds

    def before_backward(self, meta: dict[str, Any]) -> None:
        """Prepare for the backward pass."""
        if self.is_active:
            meta["means2d"].retain_grad()

    def after_backward(
        self, tables: nn.ParameterDict, optimizers: Mapping[str, Optimizer], meta: dict[str, Any], progress: float
    ) -> bool:
        """Collect gradients and refine if a round is due; returns whether tables were replaced.

        Args:
            tables: parameters of all Gaussians.
            optimizers: optimiser of each table.
            meta: packed results of the rasterizer; ``gaussian_ids`` are rows of the tables.
            progress: from 0 to 1.
        """
        if not self.is_active or meta["means2d"].grad is None:
            return False
        settings = self.settings
        share = (progress - settings.begin) / (settings.end - settings.begin)
        due = min(int(share * settings.rounds), settings.rounds) if share > 0.0 else 0
        self._strategy.step_post_backward(tables, optimizers, self._state, 2 * self._round + 1, meta, packed=True)
        if due <= self._round:
            return False
        self._round = due
        device = tables["means"].device
        with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
            torch.manual_seed(self._seed * 1_000_003 + due)
            self._set_growth_threshold(len(tables["means"]), due / settings.rounds)
            # The gradients of this step are counted by now: the threshold depends on them.
            self._strategy.step_post_backward(tables, optimizers, self._state, 2 * due, _empty_meta(meta), packed=True)
        self._reset_opacities(tables, optimizers)
        return True

    def _set_growth_threshold(self, count: int, share: float) -> None:
        self._strategy.grow_grad2d = self.settings.gradient
        free_count = max(self._initial_count + int(share * (self._max_count - self._initial_count)) - count, 0)
        means = self._state["grad2d"] / self._state["count"].clamp_min(1.0)
        if free_count < len(means):
            # A Gaussian that grows adds one, whether it is doubled or split.
            highest = float(means.topk(free_count + 1).values[-1])
            self._strategy.grow_grad2d = max(self.settings.gradient, highest)

    def _reset_opacities(self, tables: nn.ParameterDict, optimizers: Mapping[str, Optimizer]) -> None:
        """Lower all opacities. gsplat 1.5.3 never does: its condition `0 & step > 0` is false at every step."""
        due = min(self._round // self._rounds_per_reset, self.settings.resets)
        if due > self._reset and self.is_active:
            self._reset = due
            reset_opa(tables, optimizers, self._state, 2.0 * self.settings.least_opacity)

    def state(self) -> dict[str, Tensor]:
        """Return the statistics and position in the schedule, for a checkpoint."""
        statistics = {name: self._state[name] for name in _STATISTICS if self._state[name] is not None}
        return {
            "density.clock": torch.tensor([self._round, self._reset]),
            **{f"density.{n}": t for n, t in statistics.items()},
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        self._round, self._reset = state["density.clock"].tolist()
        for name in _STATISTICS:
            statistics = state.get(f"density.{name}")
            self._state[name] = None if statistics is None else statistics.clone()

    def to(self, device: torch.device) -> None:
        """Move restored statistics to the device of the tables."""
        for name in _STATISTICS:
            if self._state[name] is not None:
                self._state[name] = self._state[name].to(device)


def _empty_meta(meta: dict[str, Any]) -> dict[str, Any]:
    """Results of the rasterizer for an image that shows no Gaussian."""
    ids = meta["gaussian_ids"]
    means2d, gradient = (torch.zeros(0, 2, device=ids.device) for _ in range(2))
    means2d.grad = gradient
    vars(means2d)["absgrad"] = gradient
    return {**meta, "means2d": means2d, "gaussian_ids": ids[:0], "radii": meta["radii"][:0]}
