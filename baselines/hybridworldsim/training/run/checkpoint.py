"""Checkpoints: everything that a run needs to continue exactly, written to a temporary name and renamed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

from pydantic import RootModel
from torch import Tensor

from mirror.errors import DatasetError
from mirror.schema.files import parse_json, write_bytes

FORMAT: Final = "mirror-checkpoint/1"
_REMEDY: Final = "remove the file to train the block from the beginning"


@dataclass(frozen=True)
class Sums:
    """Sums over the steps since the last report.

    Attributes:
        steps: number of steps.
        psnr_db: sum of their PSNR.
        losses: by name, the sum and the number of steps in which the loss was computed.
    """

    steps: int = 0
    psnr_db: float = 0.0
    losses: Mapping[str, tuple[float, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Position:
    """The progress of a run.

    Attributes:
        steps: number of images trained on.
        shown: number of images read, including those without a scored pixel.
        spent_s: processor time of training.
        wall_s: wall time of training.
        reports: number of equal steps of progress that have been reported.
        rows: number of rows of the curves written so far.
        sums: sums over the steps since then.
    """

    steps: int = 0
    shown: int = 0
    spent_s: float = 0.0
    wall_s: float = 0.0
    reports: int = 0
    rows: int = 0
    sums: Sums = Sums()


class CheckpointPosition(RootModel[Position]):
    """The position as JSON."""


def write_checkpoint(path: Path, state: Mapping[str, Tensor], position: Position) -> None:
    """Write a checkpoint; if the process is killed meanwhile, the previous one remains.

    Raises:
        DatasetError: the folder is not writable, or the disk is full.
    """
    from safetensors.torch import save

    # safetensors refuses tensors that share memory.
    tensors = {name: tensor.detach().contiguous().clone() for name, tensor in state.items()}
    write_bytes(path, save(tensors, {"format": FORMAT, "position": json.dumps(asdict(position))}))


def read_checkpoint(path: Path) -> tuple[dict[str, Tensor], Position]:
    """Read the state of a trainer and its position.

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
