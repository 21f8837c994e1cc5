"""Reads public checkpoints of networks; nothing in the file is run."""

from __future__ import annotations

from torch import Tensor

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
