"""Adam for tables on a GPU: all rows at each step, by torch's fused kernel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import torch
from torch import Tensor, nn

from hybridworldsim.model.lazy_adam import BETA1, BETA2, EPS, LazyAdam


class DenseAdam:
    """Adam over all rows of tables, with the interface of `LazyAdam`.

    A row without a gradient moves by its moments, as in `LazyAdam`, but with the learning rate of each step and with
    Adam's bias corrections, where `LazyAdam` takes those of the step that uses the row again.

    Args:
        node: module that holds the tables.
        names: parameters with a row for each Gaussian or anchor. A parameter that needs no gradient is not optimised.

    Attributes:
        names: names of the optimised tables.
        steps: number of steps begun.
    """

    def __init__(self, node: nn.Module, names: Sequence[str]) -> None:
        self._node, self._names = node, names
        self.names = [name for name in names if node.get_parameter(name).requires_grad]
        self.steps = 0
        self._adam = self._make()

    def begin_step(self, rates: Mapping[str, float]) -> dict[str, Tensor]:
        """Begin a step, and return all tables (N, ...); the optimised ones are leaves that get gradients.

        Args:
            rates: learning rates of this step, by table.
        """
        self.steps += 1
        for group in self._adam.param_groups:
            group["lr"] = rates[group["name"]]
        self._adam.zero_grad(set_to_none=True)
        return {name: self._node.get_parameter(name) for name in self._names}

    def end_step(self) -> None:
        """End a step: update all rows by their gradients."""
        for name in self.names:
            table = self._node.get_parameter(name)
            if table.grad is None:
                table.grad = torch.zeros_like(table)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def catch_up(self, rates: Mapping[str, float]) -> None:
        """Do nothing: all rows are up to date."""

    @torch.no_grad()
    def replace(self, keep: Tensor, added: Mapping[str, Tensor]) -> None:
        """Remove rows and append others without moments; see `LazyAdam.replace`."""
        before = self._moments()
        for name in self._names:
            old = self._node.get_parameter(name)
            table = torch.cat([old.detach()[keep], added[name]])
            setattr(self._node, name, nn.Parameter(table, requires_grad=old.requires_grad))
        self._adam = self._make()
        for name, (first, second) in before.items():
            new = torch.zeros_like(added[name])
            self._set_moments(name, torch.cat([first[keep], new]), torch.cat([second[keep], new]))

    def state(self) -> dict[str, Tensor]:
        """Return the moments and the number of steps as tensors, for a checkpoint."""
        kept = {"dense.steps": torch.tensor(self.steps)}
        for name, (first, second) in self._moments().items():
            kept |= {f"dense.first.{name}": first, f"dense.second.{name}": second}
        return kept

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned; the tables already have their rows."""
        self.steps = int(state["dense.steps"])
        self._adam = self._make()
        for name in self.names:
            if f"dense.first.{name}" in state:
                device = self._node.get_parameter(name).device
                first, second = (state[f"dense.{moment}.{name}"].to(device).clone() for moment in ("first", "second"))
                self._set_moments(name, first, second)

    def _make(self) -> torch.optim.Adam:
        groups = [{"params": [self._node.get_parameter(name)], "name": name, "lr": 0.0} for name in self.names]
        return torch.optim.Adam(groups, betas=(BETA1, BETA2), eps=EPS, fused=True)

    def _moments(self) -> dict[str, tuple[Tensor, Tensor]]:
        found = {name: self._adam.state.get(self._node.get_parameter(name), {}) for name in self.names}
        return {name: (one["exp_avg"], one["exp_avg_sq"]) for name, one in found.items() if one}

    def _set_moments(self, name: str, first: Tensor, second: Tensor) -> None:
        table = self._node.get_parameter(name)
        count = torch.full((), float(self.steps), device=table.device)
        self._adam.state[table] = {"step": count, "exp_avg": first, "exp_avg_sq": second}


TableAdam: TypeAlias = LazyAdam | DenseAdam
"""An optimiser of the tables of a node."""
