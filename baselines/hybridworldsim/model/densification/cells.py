"""Cells of space, found by hashing: which are taken, and who is the best in each."""

from __future__ import annotations

import torch
from torch import Tensor

_BITS = 21
_HALF = 1 << (_BITS - 1)


def cell_keys(points: Tensor, size_m: float) -> Tensor:
    """(N,) int64 keys of the cells of a cubic grid that points (N, 3) lie in.

    Points beyond a million cells from the origin share the outermost ones.
    """
    grid = torch.floor(points / size_m).clamp(-_HALF, _HALF - 1).to(torch.int64) + _HALF
    return (grid[:, 0] << (2 * _BITS)) | (grid[:, 1] << _BITS) | grid[:, 2]


def best_per_cell(keys: Tensor, scores: Tensor) -> Tensor:
    """(M,) int64: of the rows that share a key the one of the highest score, the first of equal ones; best first."""
    ranked = torch.argsort(scores, descending=True, stable=True)
    _, place = torch.unique(keys[ranked], return_inverse=True)
    first = torch.full((int(place.max()) + 1 if len(place) else 0,), len(keys), dtype=torch.int64)
    first.scatter_reduce_(0, place, torch.arange(len(keys)), "amin")
    return ranked[first.sort().values]


def grow_anchors(
    points: Tensor, scores: Tensor, least_m: Tensor, occupied: Tensor, sizes_m: tuple[float, ...], room: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Where new anchors stand: at the points of the highest scores whose cells are empty, coarse cells first.

    Each size of cell has an equal part of the room; what it does not need goes to the next.

    Args:
        points: (P, 3) candidates, the Gaussians.
        scores: (P,) how much each is pulled.
        least_m: (P,) a candidate gets no cell smaller than this.
        occupied: (N, 3) anchors that stand already.
        sizes_m: of the cells, coarse to fine.
        room: how many anchors may be added.

    Returns:
        (M, 3) centres of their cells, (M,) sizes, (M,) int64 rows of the candidates.
    """
    centres, widths, parents = [occupied.new_empty(0, 3)], [occupied.new_empty(0)], [torch.empty(0, dtype=torch.int64)]
    for left, size_m in zip(range(len(sizes_m), 0, -1), sizes_m):
        standing = torch.cat([occupied, *centres])
        taken = torch.isin(cell_keys(points, size_m), cell_keys(standing, size_m))
        free = (~taken & (least_m <= size_m)).nonzero().squeeze(1)
        chosen = free[best_per_cell(cell_keys(points[free], size_m), scores[free])][: max(room // left, 0)]
        room -= len(chosen)
        centres.append((torch.floor(points[chosen] / size_m) + 0.5) * size_m)
        widths.append(points.new_full((len(chosen),), size_m))
        parents.append(chosen)
    return torch.cat(centres), torch.cat(widths), torch.cat(parents)
