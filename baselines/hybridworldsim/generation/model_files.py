"""``model.safetensors`` of a generator and of an autoencoder: parameters with the configuration that they belong to."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch
from pydantic import RootModel
from torch import nn

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder, TinySettings
from hybridworldsim.generation.network.configuration import TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from mirror.errors import DatasetError, UsageError
from mirror.schema.files import parse_json, write_bytes

_GENERATOR: Final = "mirror-generator/1"
_AUTOENCODER: Final = "mirror-autoencoder/1"
_REMEDY: Final = (
    "name a file that `mirror generate train` wrote; `mirror generate scene --base NAME --vae FOLDER` loads released"
    " weights of OpenDWM"
)


class ModelDocument(RootModel[dict[str, Any]]):
    """The configuration and format of a model, in the metadata of its file."""


def write_generator(
    path: Path,
    network: Transformer,
    references: int,
    *,
    drop_layout: float = 0.0,
    rates_hz: tuple[float, float] | None = None,
    captions: bool = False,
) -> int:
    """Write a network.

    Args:
        path: the file.
        network: the network.
        references: T, number of its reference frames.
        drop_layout: share of its training windows without boxes; above 0 it can be guided.
        rates_hz: lowest and highest rate of its training clips, frames per second; None: not stated.
        captions: whether it was trained with captions.

    Returns:
        The size of the file in bytes.
    """
    document = {"network": asdict(network.config), "references": references, "drop_layout": drop_layout}
    if rates_hz is not None:
        document["rates_hz"] = list(rates_hz)
    if captions:
        # Only then: without captions the same model has the same bytes as before they existed.
        document["captions"] = True
    return _write(path, network, _GENERATOR, document)


def read_generator(path: Path) -> tuple[Transformer, int]:
    """Read a network and the number of its reference frames.

    Raises:
        DatasetError: the file is missing, broken, or no generator.
    """
    document, state = _read(path, _GENERATOR)
    with torch.device("meta"):
        network = Transformer(_config(path, document))
    _load(path, network, state)
    return network.eval().requires_grad_(False), int(document["references"])


def captioned_config(path: Path) -> TransformerConfig:
    """Return the configuration of a generator trained with captions; its tensors are not read.

    Raises:
        UsageError: it was trained without, so that the parameters that read captions are random.
        DatasetError: the file is missing, broken, or no generator.
    """
    document = _read_document(path, _GENERATOR)
    if document.get("captions") is not True:
        raise UsageError(
            "captions for a generator that was trained without text",
            file=path,
            place="--captions",
            expected="a generator of `mirror generate train --captions`, or released weights (--base)",
            remedy="leave out --captions, or train with it",
        )
    return _config(path, document)


def require_guidance(path: Path, scale: float) -> None:
    """Check that a generator can be guided with a scale: its training must have had windows without boxes.

    Raises:
        UsageError: the scale is not 1, and there were none.
        DatasetError: the file is missing, broken, or no generator.
    """
    if scale == 1.0:
        return
    document = _read_document(path, _GENERATOR)
    if not float(document.get("drop_layout", 0.0)) > 0.0:
        raise UsageError(
            f"guidance {scale:g} of a generator that was never trained without boxes",
            file=path,
            place="--guidance",
            expected="a generator of `mirror generate train --drop-layout`; distilled ones take none",
            remedy="leave out --guidance, or train with --drop-layout 0.1",
        )


def read_references(path: Path) -> int:
    """Return the number T of a generator's reference frames; its tensors are not read.

    Raises:
        DatasetError: the file is missing, broken, or no generator.
    """
    return int(_read_document(path, _GENERATOR)["references"])


def trained_rates(path: Path) -> tuple[float, float] | None:
    """Return the lowest and highest rate of a generator's training clips, frames per second.

    None: its file states none.

    Raises:
        DatasetError: the file is missing, broken, or no generator.
    """
    rates = _read_document(path, _GENERATOR).get("rates_hz")
    return None if rates is None else (float(rates[0]), float(rates[1]))


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
        raise DatasetError(
            f"settings that do not fit ({error})",
            file=path,
            expected="a tiny autoencoder",
            remedy="train it again with this version",
        ) from error
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
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    document = _read_document(path, kind)
    try:
        return document, load_file(path)
    except (SafetensorError, OSError) as error:
        raise _unreadable(path, kind, error) from error


def _read_document(path: Path, kind: str) -> dict[str, Any]:
    """Read what a file says of its model, without the tensors."""
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise _unreadable(path, kind, error) from error
    document = parse_json(metadata.get("document", "{}").encode(), ModelDocument, path).root
    if document.get("format") != kind:
        found = document.get("format")
        problem = "tensors that state no format" if found is None else f"of format {found!r}"
        raise DatasetError(problem, file=path, expected=kind, remedy=_REMEDY)
    return document


def _config(path: Path, document: Mapping[str, Any]) -> TransformerConfig:
    try:
        return TransformerConfig.from_document(document["network"])
    except UsageError as error:
        raise DatasetError(
            str(error), file=path, expected="a generator of this version", remedy="train it again with this version"
        ) from error


def _unreadable(path: Path, kind: str, error: Exception) -> DatasetError:
    return DatasetError(f"cannot be read ({error})", file=path, expected=f"a file of {kind}", remedy=_REMEDY)


def _load(path: Path, model: nn.Module, state: Mapping[str, torch.Tensor]) -> None:
    broken = [name for name, tensor in state.items() if not bool(tensor.isfinite().all())]
    if broken:
        raise DatasetError(
            f"numbers in {broken[0]} that are not finite", file=path, expected="finite parameters", remedy=_REMEDY
        )
    try:
        model.load_state_dict(state, strict=True, assign=True)
    except RuntimeError as error:
        raise DatasetError(
            " ".join(str(error).split())[:300], file=path, expected="the tensors of its model", remedy=_REMEDY
        ) from error
