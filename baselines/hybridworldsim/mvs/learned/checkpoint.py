"""Reads public checkpoints of networks without running any code from the file."""

from __future__ import annotations

from torch import Tensor

from mirror.weights.load import load_state_dict
from mirror.weights.resolve import WeightResolver

_PARALLEL_PREFIX = "module."


def load_public_state_dict(name: str, resolver: WeightResolver) -> tuple[dict[str, Tensor], str]:
    """Load a checkpoint and remove the prefix of data-parallel training from its keys.

    Args:
        name: name of the weights in `mirror.weights.table`.
        resolver: finds the file.

    Returns:
        The tensors by the names of the network's parameters, and the sha256 of the file.

    Raises:
        WeightsUnavailableError: the file is missing, has another hash, or holds no state dict.
    """
    resolved = resolver.resolve(name)
    state = load_state_dict(resolved.path, entry="model")
    return {key.removeprefix(_PARALLEL_PREFIX): value for key, value in state.items()}, resolved.sha256
