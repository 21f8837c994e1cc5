"""Estimates of the memory and time of a training, which are printed before it starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from hybridworldsim.training.data_loader import CACHE_BYTES, GPU_CACHE_BYTES
from mirror.devices import CPU
from mirror.methods.plugin import ReconstructionTask

_PER_GAUSSIAN: Final = 330
_PER_PIXEL: Final = 115
"""Bytes of the CPU rasterizer with gradients, docs/rasterizer/speed.md."""
_LIBRARIES: Final = 600 << 20
"""Bytes of torch, numba and their code."""
_PER_DECODED: Final = 600
"""Bytes of the networks' inputs, hidden layers and gradients of a Gaussian, on a GPU, where a step decodes all."""
_COPIES: Final = 4
"""Of each table: parameters, gradients or gathered rows, and two moments."""
_STEP_CORE_S: Final = 0.038
_STEP_WIDTH_PX: Final = 240
"""Ten core-minutes made 15,900 to 18,800 steps at this width, docs/reconstruction.md."""


@dataclass(frozen=True)
class TableSizes:
    """The largest sizes that a method's tables reach.

    Attributes:
        numbers: numbers in all tables.
        gaussians: Gaussians that they describe.
    """

    numbers: int
    gaussians: int


def estimate_bytes(sizes: TableSizes, width_px: int, height_px: int) -> int:
    """Estimate the peak memory, in bytes, of training a block, without its cached images."""
    tables = 4 * _COPIES * sizes.numbers
    return tables + _PER_GAUSSIAN * sizes.gaussians + _PER_PIXEL * width_px * height_px + _LIBRARIES


def estimate_task_bytes(sizes: TableSizes, task: ReconstructionTask) -> int:
    """Estimate the peak memory, in bytes, of training a block of a task, if images are square at most."""
    width_px = task.protocol.pixels.max_width_px or _STEP_WIDTH_PX
    own = estimate_bytes(sizes, width_px, width_px)
    return own + (CACHE_BYTES if task.device == CPU else GPU_CACHE_BYTES + _PER_DECODED * sizes.gaussians)


def describe_costs(sizes: TableSizes, task: ReconstructionTask) -> str:
    """Describe the estimated memory and time of the training of a block.

    Args:
        sizes: the sizes of the method's tables.
        task: the task, with its width, budget and device.
    """
    width_px = task.protocol.pixels.max_width_px or _STEP_WIDTH_PX
    memory = f"estimated for each block: at most {estimate_task_bytes(sizes, task) / 1e9:.1f} GB of memory"
    if task.core_minutes is not None:
        return f"{memory}, {task.core_minutes:g} core-minutes"
    if task.device != CPU or task.steps is None:
        steps = "" if task.steps is None else f", {task.steps} steps"
        return f"{memory}{steps}; the time of a step is not measured on {task.device}"
    core_s = task.steps * _STEP_CORE_S * max(1.0, (width_px / _STEP_WIDTH_PX) ** 2)
    return f"{memory}, at most {core_s / 60.0:.1f} core-minutes"
