"""Exhausted memory, as an error that names the device and what to lower."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import torch

from mirror.errors import DatasetError

STREET_REMEDY: Final = (
    "a smaller --width, fewer Gaussians such as --set refinement.max_anchors=9000, or --device cpu; "
    "the same command continues from the last checkpoint"
)


@contextmanager
def exhausted_memory_named(
    device: str, remedy: str, expected: str = "memory for all networks and one batch"
) -> Iterator[None]:
    """Turn exhausted memory into an error that names the device and the remedy.

    torch has an error of its own for the memory of accelerators, and a plain one for that of the processor.

    Args:
        device: where the computation is.
        remedy: options that need less memory.
        expected: what needs the memory.

    Raises:
        DatasetError: memory is exhausted.
    """
    try:
        yield
    except (RuntimeError, MemoryError) as error:
        if not isinstance(error, torch.OutOfMemoryError | MemoryError) and "DefaultCPUAllocator" not in str(error):
            raise
        raise DatasetError(
            "the device has too little memory", place=device, expected=expected, remedy=remedy
        ) from error
