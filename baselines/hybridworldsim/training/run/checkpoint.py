"""Checkpoints: everything that a run needs to continue exactly, written to a temporary name and renamed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Final

from torch import Tensor

from hybridworldsim.training.run.position import CheckpointPosition, Position
from mirror.errors import DatasetError
from mirror.schema.files import parse_json, write_bytes

FORMAT: Final = "mirror-checkpoint/1"
_REMEDY: Final = "remove the file to train from the beginning"


def write_checkpoint(path: Path, state: Mapping[str, Tensor], position: Position) -> None:
    """Write a checkpoint; if the process is killed in between, the previous checkpoint remains.

    Raises:
        DatasetError: the folder is not writable, or the disk is full.
    """
    from safetensors.torch import save

    # safetensors refuses tensors that share memory.
    tensors = {name: tensor.detach().contiguous().clone() for name, tensor in state.items()}
    write_bytes(path, save(tensors, {"format": FORMAT, "position": json.dumps(asdict(position))}))


def read_checkpoint(path: Path) -> tuple[dict[str, Tensor], Position]:
    """Read the state of a trainer and its progress.

    Raises:
        DatasetError: the file is broken or is not a checkpoint.
        SchemaError: its position is not that of a run.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise DatasetError(f"cannot be read ({error})", file=path, expected="a checkpoint", remedy=_REMEDY) from error
    if metadata.get("format") != FORMAT:
        raise DatasetError(f"of format {metadata.get('format')!r}", file=path, expected=FORMAT, remedy=_REMEDY)
    return state, parse_json(metadata.get("position", "").encode(), CheckpointPosition, path).root
