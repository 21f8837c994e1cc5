"""Adding and removing Gaussians by gsplat's `DefaultStrategy`, in rounds that progress tells, not steps."""

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
    """The strategy with its clock, its cap and its chance.

    The strategy reads step numbers: here every round has two, the even one at which it refines and the odd one that
    stands for all steps until the next. The cap, which rises from round to round, is kept by raising the gradient above
    which Gaussians grow, so that those that need it most do. Scenes are in metres, hence its scene scale is 1.

    Args:
        settings: when and what.
        seed: of where the halves of a split Gaussian go.
        first: Gaussians to begin with.
    """

    def __init__(self, settings: Densification, seed: int, first: int) -> None:
        self.settings, self._seed = settings, seed
        self._first, self._most = first, max(settings.most, first)
        self._rounds_a_reset = max(settings.rounds // max(settings.resets, 1), 1)
        self._strategy = DefaultStrategy(
            prune_opa=settings.least_opacity,
            grow_grad2d=settings.gradient,
            grow_scale3d=settings.split_m,
            prune_scale3d=float("inf") if settings.largest_m is None else settings.largest_m,
            refine_start_iter=0,
            refine_stop_iter=2 * settings.rounds + 1,
            refine_every=2,
            reset_every=2 * self._rounds_a_reset,
            absgrad=settings.absolute,
        )
        self._state: dict[str, Any] = self._strategy.initialize_state(scene_scale=1.0)
        self._round, self._reset = 0, 0

    @property
    def is_active(self) -> bool:
        """Whether gradients in the image are still asked for."""
        return self._round < self.settings.rounds

    def before_backward(self, meta: dict[str, Any]) -> None:
        """To be called before gradients are computed."""
        if self.is_active:
            meta["means2d"].retain_grad()

    def after_backward(
        self, tables: nn.ParameterDict, optimizers: Mapping[str, Optimizer], meta: dict[str, Any], progress: float
    ) -> bool:
        """To be called with gradients; whether tables were replaced.

        Args:
            tables: parameters of all Gaussians.
            optimizers: of each.
            meta: of the rasterizer, packed, whose ``gaussian_ids`` are rows of the tables.
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
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self._seed * 1_000_003 + due)
            self._cap(len(tables["means"]), due / settings.rounds)
            # What this step told is known by now: the cap had to be set after it.
            self._strategy.step_post_backward(tables, optimizers, self._state, 2 * due, _unseen(meta), packed=True)
        self._resets(tables, optimizers)
        return True

    def _cap(self, count: int, share: float) -> None:
        self._strategy.grow_grad2d = self.settings.gradient
        room = max(self._first + int(share * (self._most - self._first)) - count, 0)
        means = self._state["grad2d"] / self._state["count"].clamp_min(1.0)
        if room < len(means):
            # Each that grows adds one, be it doubled or split.
            highest = float(means.topk(room + 1).values[-1])
            self._strategy.grow_grad2d = max(self.settings.gradient, highest)

    def _resets(self, tables: nn.ParameterDict, optimizers: Mapping[str, Optimizer]) -> None:
        """Lower all opacities; gsplat 1.5.3 never does, its condition `0 & step > 0` being false at every step."""
        due = min(self._round // self._rounds_a_reset, self.settings.resets)
        if due > self._reset and self.is_active:
            self._reset = due
            reset_opa(tables, optimizers, self._state, 2.0 * self.settings.least_opacity)

    def state(self) -> dict[str, Tensor]:
        """Statistics and where in the schedule."""
        known = {name: self._state[name] for name in _STATISTICS if self._state[name] is not None}
        return {
            "density.clock": torch.tensor([self._round, self._reset]),
            **{f"density.{n}": t for n, t in known.items()},
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """The opposite of `state`."""
        self._round, self._reset = state["density.clock"].tolist()
        for name in _STATISTICS:
            known = state.get(f"density.{name}")
            self._state[name] = None if known is None else known.clone()


def _unseen(meta: dict[str, Any]) -> dict[str, Any]:
    """What the rasterizer tells of an image that shows nothing."""
    means2d = torch.zeros(0, 2)
    means2d.grad = torch.zeros(0, 2)
    vars(means2d)["absgrad"] = torch.zeros(0, 2)
    none = torch.zeros(0, dtype=torch.int64)
    return {**meta, "means2d": means2d, "gaussian_ids": none, "radii": torch.zeros(0, 2)}
