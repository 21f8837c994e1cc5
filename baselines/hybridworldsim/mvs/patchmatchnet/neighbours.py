"""The places about each sample that propagation and aggregation look at.

They are a fixed pattern, each place moved by what a convolution of the features says.
The published weights were trained with positions that are scaled as if the centres of the outermost samples were the
borders (``W / (W - 1)``) and half a sample to the left and above, so that is what is done here: both are small, and the
learned moves have taken them in.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

Pattern = list[tuple[int, int]]


def ring(reach: int) -> Pattern:
    """The eight places (down, right) round a sample, row by row."""
    steps = (-reach, 0, reach)
    return [(down, right) for down in steps for right in steps if (down, right) != (0, 0)]


def square(reach: int) -> Pattern:
    """The nine places (down, right) of a sample and its ring, row by row."""
    steps = (-reach, 0, reach)
    return [(down, right) for down in steps for right in steps]


def positions_of(pattern: Pattern, moves: Tensor) -> Tensor:
    """Where the places of all samples are.

    Args:
        pattern: N places.
        moves: (2 N, H, W): for each place how far it is moved to the right and down, in samples.

    Returns:
        (N, H, W, 2) in the form that `gather` takes.
    """
    _, rows, columns = moves.shape
    v, u = torch.meshgrid(torch.arange(rows).float(), torch.arange(columns).float(), indexing="ij")
    fixed = torch.tensor(pattern, dtype=torch.float32).view(-1, 2, 1, 1)
    across = (u + fixed[:, 1] + moves[0::2]) / max((columns - 1) / 2.0, 0.5) - 1.0
    down = (v + fixed[:, 0] + moves[1::2]) / max((rows - 1) / 2.0, 0.5) - 1.0
    return torch.stack((across, down), dim=-1)


def gather(values: Tensor, positions: Tensor) -> Tensor:
    """Values at the places of all samples, bilinear; beyond the border what is on it.

    Args:
        values: (C, H, W).
        positions: (N, H, W, 2) of `positions_of`.

    Returns:
        (C, N, H, W).
    """
    count, rows, columns, _ = positions.shape
    grid = positions.view(1, count * rows, columns, 2)
    return functional.grid_sample(values[None], grid, "bilinear", "border", align_corners=False).view(
        -1, count, rows, columns
    )
