"""Checkpoints: all that a run needs to go on exactly, written under another name and renamed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

from torch import Tensor

from mirror.errors import DatasetError
from mirror.schema.files import write_bytes

FORMAT: Final = "mirror-checkpoint/1"
_ANEW: Final = "remove the file to train the block anew"


@dataclass(frozen=True)
class Sums:
    """What steps since the last report told.

    Attributes:
        steps: how many.
        psnr_db: sum of their PSNR.
        losses: by name, sum and in how many steps it was computed.
    """

    steps: int = 0
    psnr_db: float = 0.0
    losses: Mapping[str, tuple[float, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Position:
    """How far a run is.

    Attributes:
        steps: images that were learnt from.
        shown: with those of which nothing is scored.
        spent_s: processor time of training.
        wall_s: time on the wall, of training.
        reports: how many of the equal steps of progress are reported.
        rows: of the curves, written so far.
        sums: of the steps since.
    """

    steps: int = 0
    shown: int = 0
    spent_s: float = 0.0
    wall_s: float = 0.0
    reports: int = 0
    rows: int = 0
    sums: Sums = Sums()


def write_checkpoint(path: Path, state: Mapping[str, Tensor], position: Position) -> None:
    """Write a checkpoint; whoever is killed meanwhile leaves the one before.

    Raises:
        DatasetError: the folder is not writable, or the disk is full.
    """
    from safetensors.torch import save

    # Equal storages may not be named twice.
    tensors = {name: tensor.detach().contiguous().clone() for name, tensor in state.items()}
    write_bytes(path, save(tensors, {"format": FORMAT, "position": json.dumps(asdict(position))}))


def read_checkpoint(path: Path) -> tuple[dict[str, Tensor], Position]:
    """The state of a learner and where it was.

    Raises:
        DatasetError: it is broken, or no checkpoint.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            said = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise DatasetError(f"cannot be read ({error})", file=path, expected="a checkpoint", remedy=_ANEW) from error
    if said.get("format") != FORMAT:
        raise DatasetError(f"of format {said.get('format')!r}", file=path, expected=FORMAT, remedy=_ANEW)
    plain = json.loads(said["position"])
    sums = plain.pop("sums")
    losses = {name: (total, count) for name, (total, count) in sums.pop("losses").items()}
    return state, Position(**plain, sums=Sums(**sums, losses=losses))
