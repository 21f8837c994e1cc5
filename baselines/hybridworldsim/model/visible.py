"""Selects the points that a viewpoint may see, so that only these are decoded."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from hybridworldsim.model.plain.decoding import visible_mask
from hybridworldsim.trainable.viewpoint import Viewpoint


def select_visible(viewpoint: Viewpoint, means: Tensor, reach_m: Tensor) -> Tensor:
    """Select points whose sphere may meet the view frustum.

    Args:
        viewpoint: the camera.
        means: (N, 3) in the block's frame.
        reach_m: (N,) radius of the sphere around each.

    Returns:
        (M,) int64 rows, ascending.
    """
    if not is_compiled(means):
        return visible_mask(viewpoint, means, reach_m).nonzero().squeeze(1)
    points, radii = (np.ascontiguousarray(table.detach().numpy(), np.float32) for table in (means, reach_m))
    view, rows = viewpoint.frustum, empty_aligned(len(points), np.int64)
    edges = spans(len(points))
    counts = np.zeros(len(edges) - 1, np.int64)

    def work(part: int) -> None:
        counts[part] = find_visible(edges[part], edges[part + 1], points, radii, view, rows)

    in_parallel(work, len(counts))
    return torch.from_numpy(np.concatenate([rows[begin : begin + count] for begin, count in zip(edges, counts)]))


@kernel()
def find_visible(begin: Any, end: Any, means: Any, reach: Any, view: Any, rows: Any) -> Any:
    """Find the rows in a range whose sphere may meet a view frustum.

    Args:
        begin: first row.
        end: one past the last row.
        means: (N, 3) float32.
        reach: (N,) float32.
        view: (21,) float32, see `Viewpoint.frustum`.
        rows: (N,) int64 receives the rows, from `begin` on.

    Returns:
        Number of rows.
    """
    count = 0
    for row in range(begin, end):
        x, y, z = means[row, 0], means[row, 1], means[row, 2]
        depth = view[6] * x + view[7] * y + view[8] * z + view[11]
        r = reach[row]
        if not depth + r > view[12]:
            continue
        across = view[0] * x + view[1] * y + view[2] * z + view[9]
        down = view[3] * x + view[4] * y + view[5] * z + view[10]
        if (
            across + view[13] * depth > -r * view[17]
            and view[14] * depth - across > -r * view[18]
            and down + view[15] * depth > -r * view[19]
            and view[16] * depth - down > -r * view[20]
        ):
            rows[begin + count] = row
            count += 1
    return count
