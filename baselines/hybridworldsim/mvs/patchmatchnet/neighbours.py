"""The neighbour positions of each sample that propagation and aggregation read.

The positions are a fixed pattern plus offsets that a convolution of the features predicts. The published weights were
trained with positions that are scaled as if the centres of the outermost samples were the borders (``W / (W - 1)``),
and shifted by half a sample to the left and above. This module does the same: both differences are small, and the
learned offsets compensate them.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.mvs.learned.warping import sample_positions

Pattern = list[tuple[int, int]]


def make_ring(reach: int) -> Pattern:
    """Make the pattern of the eight neighbours (down, right) around a sample, row by row."""
    steps = (-reach, 0, reach)
    return [(down, right) for down in steps for right in steps if (down, right) != (0, 0)]


def make_square(reach: int) -> Pattern:
    """Make the pattern of a sample and its eight neighbours (down, right), row by row."""
    steps = (-reach, 0, reach)
    return [(down, right) for down in steps for right in steps]


def compute_positions(pattern: Pattern, offsets: Tensor) -> Tensor:
    """Compute the neighbour positions of all samples.

    Args:
        pattern: N neighbours.
        offsets: (2 N, H, W): for each neighbour its offset to the right and down, in samples.

    Returns:
        (N, H, W, 2) as `gather` takes them.
    """
    _, rows, columns = offsets.shape
    v, u = sample_positions(rows, columns, offsets.device)
    fixed = torch.tensor(pattern, dtype=torch.float32, device=offsets.device).view(-1, 2, 1, 1)
    across = (u + fixed[:, 1] + offsets[0::2]) / max((columns - 1) / 2.0, 0.5) - 1.0
    down = (v + fixed[:, 0] + offsets[1::2]) / max((rows - 1) / 2.0, 0.5) - 1.0
    return torch.stack((across, down), dim=-1)


def gather(values: Tensor, positions: Tensor) -> Tensor:
    """Sample values at neighbour positions, bilinear; positions outside take the value at the border.

    Args:
        values: (C, H, W).
        positions: (N, H, W, 2) from `compute_positions`.

    Returns:
        (C, N, H, W).
    """
    count, rows, columns, _ = positions.shape
    grid = positions.view(1, count * rows, columns, 2)
    return functional.grid_sample(values[None], grid, "bilinear", "border", align_corners=False).view(
        -1, count, rows, columns
    )
