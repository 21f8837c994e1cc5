"""Parameters and Adam's moments as named tensors, whose sizes may have changed since the model was made."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor, nn
from torch.optim import Optimizer

from mirror.errors import DatasetError

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


def dump(module: nn.Module, optimizer: Optimizer) -> dict[str, Tensor]:
    """All parameters and moments, by name.

    Args:
        module: the model.
        optimizer: Adam of it.
    """
    found: dict[str, Tensor] = {}
    for name, parameter in module.named_parameters():
        found[f"model.{name}"] = parameter.detach()
        for moment in _MOMENTS:
            if moment in optimizer.state.get(parameter, {}):
                found[f"adam.{name}.{moment}"] = optimizer.state[parameter][moment]
    return found


def load(module: nn.Module, state: Mapping[str, Tensor], optimizer: Optimizer | None = None) -> None:
    """Set parameters, of whatever number of rows, and moments.

    Args:
        module: of the same kind as the one that was dumped.
        state: of `dump`; what is neither of the model nor of Adam is left alone.
        optimizer: Adam of the module; None: it is not to learn.

    Raises:
        DatasetError: a parameter is missing.
    """
    for name, parameter in module.named_parameters():
        key = f"model.{name}"
        if key not in state:
            raise DatasetError(f"no {key} in the checkpoint", expected="a checkpoint of the same method and settings")
        parameter.data = state[key].to(parameter.dtype).clone()
        if optimizer is None:
            continue
        moments = {m: state[f"adam.{name}.{m}"].clone() for m in _MOMENTS if f"adam.{name}.{m}" in state}
        if moments:
            optimizer.state[parameter] = moments
        else:
            optimizer.state.pop(parameter, None)
