"""Reads a state dict: only tensors are loaded, and no code in the file is run."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import TYPE_CHECKING

from mirror.weights.errors import WeightsUnavailableError

if TYPE_CHECKING:
    from torch import Tensor


def load_state_dict(path: Path, *, entry: str | None = None) -> dict[str, Tensor]:
    """Load the tensors of a file by name, on the CPU.

    Args:
        path: a file that ``torch.save`` wrote of a state dict, or of a dict that holds one.
        entry: the entry of the file that is the state dict; None: the file itself is the state dict.

    Raises:
        WeightsUnavailableError: the file holds other values than tensors by name.
    """
    import torch

    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError) as error:
        raise WeightsUnavailableError(
            f"no state dict can be read without running code: {error}".splitlines()[0],
            file=path,
            expected="a state dict, written by torch.save",
        ) from error
    if entry is not None:
        if not isinstance(state, dict) or entry not in state:
            raise WeightsUnavailableError(
                f"has no entry {entry!r}", file=path, expected=f"a training checkpoint with its state dict in {entry!r}"
            )
        state = state[entry]
    if not isinstance(state, dict) or not all(isinstance(value, torch.Tensor) for value in state.values()):
        raise WeightsUnavailableError(f"holds a {type(state).__name__}", file=path, expected="tensors by name")
    return dict(state)
