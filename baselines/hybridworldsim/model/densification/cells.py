"""Cells of space, found by hashing: which are occupied, and which point scores best in each."""

from __future__ import annotations

import torch
from torch import Tensor

_BITS = 21
_HALF = 1 << (_BITS - 1)


def cell_keys(points: Tensor, size_m: float) -> Tensor:
    """Return the keys (N,) of the cells of a cubic grid that points (N, 3) lie in, int64.

    Points beyond a million cells from the origin share the outermost cells.
    """
    grid = torch.floor(points / size_m).clamp(-_HALF, _HALF - 1).to(torch.int64) + _HALF
    return (grid[:, 0] << (2 * _BITS)) | (grid[:, 1] << _BITS) | grid[:, 2]


def best_per_cell(keys: Tensor, scores: Tensor) -> Tensor:
    """Return the row with the highest score for each key (M,); of equal scores, the first row.

    The best rows come first.
    """
    ranked_rows = torch.argsort(scores, descending=True, stable=True)
    _, group = torch.unique(keys[ranked_rows], return_inverse=True)
    best_ranks = torch.full(
        (int(group.max()) + 1 if len(group) else 0,), len(keys), dtype=torch.int64, device=keys.device
    )
    best_ranks.scatter_reduce_(0, group, torch.arange(len(keys), device=keys.device), "amin")
    return ranked_rows[best_ranks.sort().values]


def grow_anchors(
    points: Tensor, scores: Tensor, min_size_m: Tensor, occupied: Tensor, sizes_m: tuple[float, ...], free_count: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Choose places for new anchors: points with the highest scores in empty cells, coarse cells first.

    Each cell size gets an equal share of the free count; what it does not use goes to the next size.

    Args:
        points: (P, 3) candidates: the means of Gaussians.
        scores: (P,) mean gradient length of each.
        min_size_m: (P,) smallest cell that a candidate may get.
        occupied: (N, 3) existing anchors.
        sizes_m: edges of the cells, coarse to fine.
        free_count: largest number of new anchors.

    Returns:
        (M, 3) centres of the new anchors' cells, (M,) their sizes, (M,) int64 rows of the candidates.
    """
    centres, widths = [occupied.new_empty(0, 3)], [occupied.new_empty(0)]
    parents = [torch.empty(0, dtype=torch.int64, device=occupied.device)]
    for remaining_sizes, size_m in zip(range(len(sizes_m), 0, -1), sizes_m):
        anchors = torch.cat([occupied, *centres])
        is_occupied = torch.isin(cell_keys(points, size_m), cell_keys(anchors, size_m))
        candidates = (~is_occupied & (min_size_m <= size_m)).nonzero().squeeze(1)
        chosen = candidates[best_per_cell(cell_keys(points[candidates], size_m), scores[candidates])][
            : max(free_count // remaining_sizes, 0)
        ]
        free_count -= len(chosen)
        centres.append((torch.floor(points[chosen] / size_m) + 0.5) * size_m)
        widths.append(points.new_full((len(chosen),), size_m))
        parents.append(chosen)
    return torch.cat(centres), torch.cat(widths), torch.cat(parents)
