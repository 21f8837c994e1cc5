"""The file of a trained tiny network: parameters in half precision, with the sizes that they belong to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import torch

from hybridworldsim.petr.tiny.network import TinyPetr
from hybridworldsim.petr.tiny.settings import CLASSES, NetworkSettings, document
from mirror.errors import UsageError
from mirror.schema.files import write_bytes
from mirror.schema.strict_json import decode_json
from mirror.weights.resolve import file_sha256

_FORMAT: Final = "mirror-petr-tiny/1"


def write_model(path: Path, network: TinyPetr) -> int:
    """Write a network in half precision, and return the size of the file in bytes."""
    from safetensors.torch import save

    tensors = {
        name: (value.half() if value.is_floating_point() else value).cpu().contiguous().clone()
        for name, value in network.state_dict().items()
    }
    # One entry of metadata: the order of several is not fixed, and the same model must have the same bytes.
    header = {"format": _FORMAT, "classes": CLASSES, "network": document(network.settings)}
    data = save(tensors, {"document": json.dumps(header)})
    write_bytes(path, data)
    return len(data)


def read_model(path: Path, *, sha256: str | None = None) -> tuple[TinyPetr, str]:
    """Read a network, ready for use, and the hash of its file.

    Args:
        path: ``model.safetensors`` of a run of ``mirror annotate train``.
        sha256: expected hash; None: any.

    Raises:
        UsageError: the file is missing, broken, another one, or of another version.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise UsageError(
            "no such file", file=path, expected="model.safetensors of `mirror annotate train`",
            remedy="give it: --set weights=FILE, or leave the setting out for the network that is installed",
        )  # fmt: skip
    digest = file_sha256(path)
    if sha256 is not None and digest != sha256:
        raise UsageError(
            f"sha256 {digest}", file=path, expected=sha256, remedy="install the package, or copy the file, again"
        )
    try:
        with safe_open(path, framework="pt") as file:
            header = decode_json((file.metadata() or {}).get("document", "{}"))
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise UsageError(f"cannot be read ({error})", file=path, expected=f"a file of {_FORMAT}") from error
    if header.get("format") != _FORMAT or tuple(header.get("classes", ())) != CLASSES:
        raise UsageError(f"of format {header.get('format')!r}", file=path, expected=f"{_FORMAT}, classes {CLASSES}")
    try:
        sizes: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in header["network"].items()
        }
        network = TinyPetr(NetworkSettings(**sizes))
        network.load_state_dict(state)
    except (TypeError, KeyError, RuntimeError) as error:
        raise UsageError(
            f"parameters that do not fit ({str(error).splitlines()[0][:160]})",
            file=path,
            expected="a model of this version",
        ) from error
    broken = [name for name, value in state.items() if not bool(torch.isfinite(value.float()).all())]
    if broken:
        raise UsageError(f"{broken[0]} is not finite", file=path, expected="finite parameters", remedy="train again")
    return network.float().eval().requires_grad_(False), digest
