"""Loads released weights strictly by key: every tensor of the file is used, and only the background adapter is new."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

import torch
from torch import Tensor

from hybridworldsim.generation.network.adapter import ImageAdapter
from hybridworldsim.generation.network.configuration import BASES, TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.load import load_state_dict

_NEW: Final = "background_adapter."
_NAMED: Final = 3


def read_weights(path: Path) -> dict[str, Tensor]:
    """Read tensors by name from a ``.safetensors`` file, or from a file that ``torch.save`` wrote.

    Raises:
        WeightsUnavailableError: the file is missing or holds something else.
    """
    if not path.is_file():
        raise WeightsUnavailableError("no such file", file=path, expected="a state dict of the transformer")
    if path.suffix != ".safetensors":
        return load_state_dict(path)
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        return load_file(path)
    except (SafetensorError, OSError) as error:
        raise WeightsUnavailableError(f"cannot be read ({error})", file=path, expected="a safetensors file") from error


def load_transformer(path: Path, config: TransformerConfig, *, dtype: torch.dtype | None = None) -> Transformer:
    """Load a transformer from a released state dict.

    Args:
        path: the file.
        config: the configuration, such as `CTSD_35`. With a background adapter the file may hold its tensors or none
            of them; then the adapter begins without effect on the output.
        dtype: type of the parameters; None: that of the file.

    Raises:
        WeightsUnavailableError: the file is missing, or a name, a shape or a number does not fit.
    """
    state = read_weights(path)
    with torch.device("meta"):
        network = Transformer(config)
    expected = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    adapter_is_new = config.background is not None and not any(name.startswith(_NEW) for name in state)
    if adapter_is_new:
        expected = {name: shape for name, shape in expected.items() if not name.startswith(_NEW)}
    _require_same(path, expected, state, config)
    if dtype is not None:
        state = {name: tensor.to(dtype) for name, tensor in state.items()}
    network.load_state_dict(state, strict=False, assign=True)
    if adapter_is_new and config.background is not None:
        adapter = ImageAdapter(config.background, config.token_px, config.width)
        network.background_adapter = adapter.to(network.proj_out.weight.dtype)
    return network


def _require_same(
    path: Path, expected: dict[str, tuple[int, ...]], state: dict[str, Tensor], config: TransformerConfig
) -> None:
    missing, unknown = sorted(expected.keys() - state.keys()), sorted(state.keys() - expected.keys())
    if missing or unknown:
        found = [name for name, base in BASES.items() if base != config and _keys_of(base) == state.keys()]
        remedy = (
            f"load it as {found[0]} (--base {found[0]})"
            if found
            else "give the checkpoint of the model that was asked for"
        )
        parts = [f"{len(missing)} tensors are missing{_some(missing)}"] if missing else []
        parts += [f"{len(unknown)} are unknown{_some(unknown)}"] if unknown else []
        raise WeightsUnavailableError(
            " and ".join(parts), file=path, expected=f"the {len(expected)} tensors of this model", remedy=remedy
        )
    for name, shape in expected.items():
        if tuple(state[name].shape) != shape:
            raise WeightsUnavailableError(
                f"{name} has shape {tuple(state[name].shape)}", file=path, expected=str(shape),
                remedy="give the configuration that the weights were trained with",
            )  # fmt: skip
        if not bool(state[name].sum(dtype=torch.float64).isfinite()):
            raise WeightsUnavailableError(
                f"{name} holds numbers that are not finite",
                file=path,
                remedy="train again with a smaller learning rate, or name another file",
            )


@cache
def _keys_of(config: TransformerConfig) -> frozenset[str]:
    with torch.device("meta"):
        return frozenset(Transformer(config).state_dict())


def _some(names: list[str]) -> str:
    return f" ({', '.join(names[:_NAMED])}{', ...' if len(names) > _NAMED else ''})"
