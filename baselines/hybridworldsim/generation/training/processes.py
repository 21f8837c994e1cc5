"""Several processes that train one model, started by ``torchrun``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch.distributed


@dataclass(frozen=True)
class Processes:
    """The processes of a training.

    Attributes:
        rank: number of this one.
        count: number of all.
    """

    rank: int = 0
    count: int = 1

    @property
    def leads(self) -> bool:
        """Whether this process writes files."""
        return self.rank == 0

    @contextmanager
    def leader_first(self) -> Iterator[None]:
        """The leading process runs the block first, then the others; each waits for the other part."""
        if self.count > 1 and not self.leads:
            torch.distributed.barrier()
        yield
        if self.count > 1 and self.leads:
            torch.distributed.barrier()
        if self.count > 1:
            torch.distributed.barrier()


def leads_process() -> bool:
    """Whether this process is the only one or the leading one of those that ``torchrun`` started: it prints."""
    return int(os.environ.get("RANK", "0")) == 0


@contextmanager
def join_processes(device: str) -> Iterator[Processes]:
    """Join the processes that ``torchrun`` started; without it this process is the only one.

    Args:
        device: where the model is trained; decides how gradients are exchanged.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield Processes()
        return
    torch.distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo")
    try:
        yield Processes(int(os.environ["RANK"]), count)
    finally:
        torch.distributed.destroy_process_group()
