"""Fill a network from a public checkpoint: every tensor named and of its size, nothing in the file run."""

from __future__ import annotations

from torch import Tensor, nn

from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.load import load_state_dict
from mirror.weights.resolve import WeightResolver

_PARALLEL = "module."


def public_state_dict(name: str, resolver: WeightResolver) -> tuple[dict[str, Tensor], str]:
    """Tensors of a checkpoint under the names of its network, without the prefix of data-parallel training; its sha256.

    Args:
        name: of the weights, as in `mirror.weights.table`.
        resolver: where they are looked for.

    Raises:
        WeightsUnavailableError: the file is missing, is another one, or holds no state dict.
    """
    resolved = resolver.resolve(name)
    state = load_state_dict(resolved.path, entry="model")
    return {key.removeprefix(_PARALLEL): value for key, value in state.items()}, resolved.sha256


def fill(network: nn.Module, state: dict[str, Tensor], name: str) -> None:
    """Fill a network strictly.

    Args:
        network: of the published architecture.
        state: tensors by name.
        name: of the weights, for the error.

    Raises:
        WeightsUnavailableError: a tensor is missing, is not one of the network's, or has another shape.
    """
    wanted = network.state_dict()
    faults = [f"{key} is missing" for key in wanted if key not in state]
    faults += [f"{key} is not part of it" for key in state if key not in wanted]
    faults += [
        f"{key} is {tuple(value.shape)}, not {tuple(wanted[key].shape)}"
        for key, value in state.items()
        if key in wanted and value.shape != wanted[key].shape
    ]
    if faults:
        raise WeightsUnavailableError(
            f"not the weights of this network: {faults[0]}" + (f", and {len(faults) - 1} more" if faults[1:] else ""),
            place=name,
            expected=f"{len(wanted)} tensors of the published architecture",
            remedy="take the checkpoint that docs/weights.md names",
        )
    network.load_state_dict(state)
