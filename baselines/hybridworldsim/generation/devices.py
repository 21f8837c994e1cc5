"""Computation of networks on a device: precision, repetition bit for bit, and what to lower without memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Final, Literal, TypeAlias

import torch

from mirror.errors import UsageError

Precision: TypeAlias = Literal["float32", "bf16"]
"""Of the computation of a network, whose parameters are float32."""

TRAINING_REMEDY: Final = "more --accumulate, a smaller --batch, --recompute, or --precision bf16"
GENERATION_REMEDY: Final = "a smaller --size, fewer --cameras, or another --device"


def computing_in(precision: Precision, device: torch.device | str) -> AbstractContextManager[object]:
    """Return the context in which a network computes in a precision on a device."""
    return nullcontext() if precision == "float32" else torch.autocast(torch.device(device).type, torch.bfloat16)


@contextmanager
def repeating_exactly(device: str) -> Iterator[None]:
    """Make a CUDA device give equal bits for equal computations, as a CPU always does.

    Args:
        device: where the networks are.
    """
    if torch.device(device).type != "cuda":
        yield
        return
    # cuBLAS reads it when it is first used; with other workspaces its sums have no fixed order.
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    before = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
    # With warnings only, torch leaves attention without a fixed order of its sums.
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before[0], warn_only=before[1])


def require_counts(**counts: int) -> None:
    """Check counts of steps or threads, given by option name.

    Raises:
        UsageError: one is below 1.
    """
    for name, count in counts.items():
        if count < 1:
            words = name.replace("_", " ")
            raise UsageError(f"{count} {words}", place=f"--{name.replace('_', '-')}", expected="at least 1")


def require_seed(seed: int) -> None:
    """Check a seed of random numbers.

    Raises:
        UsageError: it is below 0.
    """
    if seed < 0:
        raise UsageError(f"seed {seed}", place="--seed", expected="0 or above")
