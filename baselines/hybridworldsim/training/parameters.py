"""``model.safetensors``: the parameters of a trained model, in single or half precision."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import torch
from torch import Tensor, nn

from mirror.errors import DatasetError
from mirror.schema.files import write_bytes

FORMAT: Final = "mirror-model/1"
_PLACES: Final = "means"


def write_parameters(path: Path, model: nn.Module, *, half: bool) -> int:
    """Write all parameters of a model.

    Args:
        path: the file.
        model: the trained model.
        half: store tables with a row for each Gaussian in 16 bits, except positions, which need 32.

    Returns:
        Size of the file, bytes.

    Raises:
        DatasetError: the folder is not writable, or a number does not fit.
    """
    from safetensors.torch import save

    tensors: dict[str, Tensor] = {}
    counts = {len(table) for name, table in model.named_parameters() if _is_places(name)} if half else set()
    for name, parameter in model.named_parameters():
        tensor = parameter.detach().contiguous().clone()
        if tensor.dtype == torch.float32 and tensor.dim() and len(tensor) in counts and not _is_places(name):
            tensor = tensor.to(torch.float16)
            if not bool(tensor.isfinite().all()):
                raise DatasetError(
                    f"{name} does not fit half precision", file=path, expected="numbers below 65504",
                    remedy="write it in single precision: leave --fp16 out",
                )  # fmt: skip
        tensors[name] = tensor
    data = save(tensors, {"format": FORMAT})
    write_bytes(path, data)
    return len(data)


def _is_places(name: str) -> bool:
    return name.rpartition(".")[2] == _PLACES


def read_parameters(path: Path) -> dict[str, Tensor]:
    """Read parameters by name, in the precision of the file.

    Raises:
        DatasetError: the file is missing or broken, or is not a model.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise DatasetError(f"cannot be read ({error})", file=path, expected="a trained model") from error
    if metadata.get("format") != FORMAT:
        raise DatasetError(f"of format {metadata.get('format')!r}", file=path, expected=FORMAT)
    return tensors


def set_parameters(model: nn.Module, parameters: Mapping[str, Tensor]) -> None:
    """Set the parameters of a model; the number of rows may differ.

    Raises:
        DatasetError: the parameters belong to another model.
    """
    own = dict(model.named_parameters())
    if set(own) != set(parameters):
        differing = sorted(set(own) ^ set(parameters))
        raise DatasetError(
            f"parameters of another model: {', '.join(differing[:3])}", expected="the method and settings of the run"
        )
    for name, parameter in own.items():
        parameter.data = parameters[name].to(parameter.dtype).clone()
