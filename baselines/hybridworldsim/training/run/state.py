"""Parameters and Adam's moments as named tensors; their number of rows may differ from the initial model's."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from mirror.errors import DatasetError

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


def dump(module: nn.Module, optimizer: Optimizer) -> dict[str, Tensor]:
    """Return all parameters and moments, by name.

    Args:
        module: the model.
        optimizer: the model's Adam optimiser.
    """
    tensors: dict[str, Tensor] = {}
    for name, parameter in module.named_parameters():
        tensors[f"model.{name}"] = parameter.detach()
        for moment in _MOMENTS:
            if moment in optimizer.state.get(parameter, {}):
                tensors[f"adam.{name}.{moment}"] = optimizer.state[parameter][moment]
    return tensors


def load(module: nn.Module, state: Mapping[str, Tensor], optimizer: Optimizer | None = None) -> None:
    """Set a module's parameters and its optimiser's moments; the numbers of rows may change.

    Args:
        module: a module of the same kind as the dumped one.
        state: result of `dump`; other entries are ignored.
        optimizer: the module's Adam optimiser; None: the module is not trained further.

    Raises:
        DatasetError: a parameter is missing.
    """
    for name, parameter in module.named_parameters():
        key = f"model.{name}"
        if key not in state:
            raise DatasetError(f"no {key} in the checkpoint", expected="a checkpoint of the same method and settings")
        parameter.data = state[key].to(parameter.device, parameter.dtype).clone()
        if optimizer is None:
            continue
        found = {moment: state[key] for moment in _MOMENTS if (key := f"adam.{name}.{moment}") in state}
        moments = {moment: one.to(_place(moment, parameter, optimizer)).clone() for moment, one in found.items()}
        if moments:
            optimizer.state[parameter] = moments
        else:
            optimizer.state.pop(parameter, None)


def _place(moment: str, parameter: Tensor, optimizer: Optimizer) -> torch.device:
    """The device of a moment: Adam counts its steps on the processor, unless it is fused or capturable."""
    on_device = moment != "step" or optimizer.defaults.get("fused") or optimizer.defaults.get("capturable")
    return parameter.device if on_device else torch.device("cpu")
