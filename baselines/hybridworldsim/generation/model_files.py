"""``model.safetensors`` of a generator and of an autoencoder: parameters with the configuration that they belong to."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder, TinySettings
from hybridworldsim.generation.network.configuration import TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from mirror.errors import DatasetError, UsageError
from mirror.schema.files import write_bytes
from mirror.schema.strict_json import decode_json

_GENERATOR: Final = "mirror-generator/1"
_AUTOENCODER: Final = "mirror-autoencoder/1"


def write_generator(path: Path, network: Transformer, references: int) -> int:
    """Write a network and T, the number of its reference frames; returns the size of the file in bytes."""
    return _write(path, network, _GENERATOR, {"network": asdict(network.config), "references": references})


def read_generator(path: Path) -> tuple[Transformer, int]:
    """Read a network and the number of its reference frames.

    Raises:
        DatasetError: the file is missing, broken, or no generator.
    """
    document, state = _read(path, _GENERATOR)
    try:
        config = TransformerConfig.from_document(document["network"])
    except UsageError as error:
        raise DatasetError(str(error), file=path, expected="a generator of this version") from error
    with torch.device("meta"):
        network = Transformer(config)
    _load(path, network, state)
    return network.eval().requires_grad_(False), int(document["references"])


def write_autoencoder(path: Path, model: TinyAutoencoder) -> int:
    """Write an autoencoder; returns the size of the file in bytes."""
    return _write(path, model, _AUTOENCODER, {"settings": asdict(model.settings)})


def read_autoencoder(path: Path) -> TinyAutoencoder:
    """Read an autoencoder.

    Raises:
        DatasetError: the file is missing, broken, or no autoencoder.
    """
    document, state = _read(path, _AUTOENCODER)
    try:
        settings = TinySettings(**document["settings"])
    except (TypeError, KeyError) as error:
        raise DatasetError(f"settings that do not fit ({error})", file=path, expected="a tiny autoencoder") from error
    with torch.device("meta"):
        model = TinyAutoencoder(settings)
    _load(path, model, state)
    return model.eval().requires_grad_(False)


def _write(path: Path, model: nn.Module, kind: str, document: Mapping[str, Any]) -> int:
    from safetensors.torch import save

    tensors = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in model.state_dict().items()}
    # One entry of metadata: the order of several is not fixed, and the same model must have the same bytes.
    data = save(tensors, {"document": json.dumps({"format": kind, **document})})
    write_bytes(path, data)
    return len(data)


def _read(path: Path, kind: str) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise DatasetError(f"cannot be read ({error})", file=path, expected=f"a file of {kind}") from error
    document = decode_json(metadata.get("document", "{}"))
    if document.get("format") != kind:
        raise DatasetError(f"of format {document.get('format')!r}", file=path, expected=kind)
    return document, state


def _load(path: Path, model: nn.Module, state: Mapping[str, torch.Tensor]) -> None:
    try:
        model.load_state_dict(state, strict=True, assign=True)
    except RuntimeError as error:
        raise DatasetError(
            " ".join(str(error).split())[:300], file=path, expected="the tensors of its model"
        ) from error
