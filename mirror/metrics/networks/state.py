"""Load state dicts strictly: every tensor named, none missing, none left over that is not known to be unused."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor, nn

from mirror.weights.errors import WeightsUnavailableError


def load_strictly(network: nn.Module, state: Mapping[str, Tensor], *, unused: tuple[str, ...] = ()) -> None:
    """Fill a network and make it ready for inference.

    Args:
        network: to be filled.
        state: tensors by name.
        unused: prefixes of tensors that the network does not need, such as ``classifier.``.

    Raises:
        WeightsUnavailableError: a tensor is missing, left over or of another shape; the first few are named.
    """
    given = {name: tensor for name, tensor in state.items() if not name.startswith(unused or ("\0",))}
    wanted = network.state_dict()
    faults = [f"{name} is missing" for name in wanted if name not in given]
    faults += [f"{name} is unknown, it is not part of it" for name in given if name not in wanted]
    faults += [
        f"{name} is {tuple(tensor.shape)}, not {tuple(wanted[name].shape)}"
        for name, tensor in given.items()
        if name in wanted and tensor.shape != wanted[name].shape
    ]
    if faults:
        shown = "; ".join(faults[:4]) + (f"; and {len(faults) - 4} more" if len(faults) > 4 else "")
        raise WeightsUnavailableError(
            f"not the weights of {type(network).__name__}: {shown}", expected=f"{len(wanted)} tensors"
        )
    network.load_state_dict(given)
    network.requires_grad_(False).eval()
