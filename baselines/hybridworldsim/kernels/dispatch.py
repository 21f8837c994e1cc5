"""Decides which form of a computation runs: the compiled kernel, or plain torch, which runs on any device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Final

from mirror.devices import CPU

if TYPE_CHECKING:
    from torch import Tensor

_PLAIN: Final = ContextVar("plain", default=False)


def is_compiled(tensor: Tensor) -> bool:
    """Return whether the compiled kernels compute with a tensor: on the CPU, unless plain torch is requested."""
    return runs_kernels(tensor.device.type)


def runs_kernels(device: str) -> bool:
    """Return whether the compiled kernels compute for a device: for the CPU, unless plain torch is requested.

    Args:
        device: as torch names it.
    """
    return device == CPU and not _PLAIN.get()


@contextmanager
def plain_torch() -> Iterator[None]:
    """Compute in plain torch on the CPU too, to compare with the compiled kernels.

    Only what has both forms changes: the rasterizer of the CPU stays compiled.
    """
    token = _PLAIN.set(True)
    try:
        yield
    finally:
        _PLAIN.reset(token)
