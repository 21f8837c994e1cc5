"""Several processes that train one model, started by ``torchrun``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Final

import torch
import torch.distributed

from mirror.errors import DatasetError, UsageError

_TIMEOUT: Final = timedelta(days=7)
"""The others wait while one process trains an autoencoder."""
_REMEDY: Final = (
    "see the message of the process that stopped first; the same command continues from the last checkpoint"
)


@dataclass(frozen=True)
class Processes:
    """The processes of a training.

    Attributes:
        rank: number of this one.
        count: number of all.
        device: where this one computes.
    """

    rank: int = 0
    count: int = 1
    device: str = "cpu"

    @property
    def leads(self) -> bool:
        """Return whether this process writes files."""
        return self.rank == 0

    def any(self, flag: bool) -> bool:
        """Return whether the flag is set in at least one process; every process must call it."""
        if self.count == 1:
            return flag
        shared = torch.tensor(float(flag), device=self.device)
        torch.distributed.all_reduce(shared, torch.distributed.ReduceOp.MAX)
        return bool(shared)

    @contextmanager
    def leader_first(self) -> Iterator[None]:
        """Run the block first in the leading process, then in the others, which wait for it.

        Raises:
            DatasetError: the leading process failed or was interrupted, in the others.
        """
        if self.leads:
            done = False
            try:
                yield
                done = True
            finally:
                self.any(not done)
        else:
            if self.any(False):
                raise DatasetError("the leading process stopped", expected="all processes", remedy=_REMEDY)
            yield
        self.any(False)


ALONE: Final = Processes()
"""One process, without others."""


def leads_process() -> bool:
    """Return whether this process prints: it is the only one, or the leading one that ``torchrun`` started."""
    return int(os.environ.get("RANK", "0")) == 0


@contextmanager
def join_processes(device: str) -> Iterator[Processes]:
    """Join the processes that ``torchrun`` started; without ``torchrun`` this process is the only one.

    Args:
        device: where the model is trained; decides how gradients are exchanged. Of several processes on CUDA each has
            the GPU of its number on the machine.

    Raises:
        UsageError: there are more processes than GPUs.
        DatasetError: another process stopped while this one waited for it.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield Processes(device=device)
        return
    if torch.device(device).type == "cuda":
        device = _own_gpu()
    torch.distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo", timeout=_TIMEOUT)
    try:
        yield Processes(int(os.environ["RANK"]), count, device)
    except RuntimeError as error:
        if not isinstance(error, torch.distributed.DistError) and "gloo" not in str(error):
            raise
        raise DatasetError("another process of the training stopped", expected=f"{count}", remedy=_REMEDY) from error
    finally:
        torch.distributed.destroy_process_group()


def _own_gpu() -> str:
    local, gpus = int(os.environ["LOCAL_RANK"]), torch.cuda.device_count()
    if local >= gpus:
        raise UsageError(
            f"process {local} on a machine with {gpus} GPUs", place="--device", expected="a GPU for each process",
            remedy=f"torchrun --nproc-per-node {gpus}",
        )  # fmt: skip
    torch.cuda.set_device(local)
    return f"cuda:{local}"
