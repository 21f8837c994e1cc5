"""Code-Gaussians are split where image gradients are large, and removed once they are transparent."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.model.dense_adam import TableAdam
from hybridworldsim.model.densification.image_gradients import ImageGradients
from hybridworldsim.model.densification.schedule import target_count
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians
from hybridworldsim.model.settings import AnchorRefinement
from hybridworldsim.model.splats import DecodedSplats

_MIN_RENDERS = 2.0
_HALF_OFFSET = 0.6
_SPLIT_SHRINK = 1.6
_MIN_OPACITY = 0.005


class CodeRefiner:
    """A collector of statistics of Code-Gaussians that refines them.

    Args:
        node: the Code-Gaussians; their tables are replaced.
        tables: optimiser of the tables.
        refinement: the schedule.
        max_count: largest number of Gaussians.
    """

    def __init__(self, node: CodeGaussians, tables: TableAdam, refinement: AnchorRefinement, max_count: int) -> None:
        self._node, self._tables, self._refinement = node, tables, refinement
        self._initial_count, self._max_count = len(node), max_count
        self._clear()

    def accumulate(self, part: DecodedSplats, gradients: ImageGradients) -> None:
        """Add the statistics of one image; see `AnchorRefiner.accumulate`."""
        ids = part.rows[gradients.rows]
        self._gradient_sum.index_add_(0, ids, gradients.lengths)
        self._render_count.index_add_(0, ids, gradients.shown)

    @torch.no_grad()
    def refine(self, refinement_number: int) -> None:
        """Remove transparent Gaussians, and split the ones with the largest gradients in two along their longest axis.

        Args:
            refinement_number: number of this refinement, from 1.
        """
        node = self._node
        is_removed = node.logits.sigmoid() < _MIN_OPACITY
        free_count = max(
            target_count(self._refinement, refinement_number, self._initial_count, self._max_count)
            - len(node)
            + int(is_removed.sum()),
            0,
        )
        score = torch.where(
            (self._render_count >= _MIN_RENDERS) & ~is_removed,
            self._gradient_sum / self._render_count.clamp_min(1.0),
            0.0,
        )
        best = torch.argsort(score, descending=True, stable=True)[:free_count]
        split = best[score[best] > 0.0]
        is_removed[split] = True
        if is_removed.any():
            self._tables.replace((~is_removed).nonzero().squeeze(1), self._halves(split))
        self._clear()

    def _halves(self, rows: Tensor) -> dict[str, Tensor]:
        node = self._node
        scales = node.log_scales[rows]
        longest = functional.one_hot(scales.argmax(1), 3).to(scales.dtype)
        axis = _rotate(node.quats[rows], longest * scales.exp())
        smaller = scales - longest * torch.tensor(_SPLIT_SHRINK).log()
        return {
            "means": torch.cat([node.means[rows] + _HALF_OFFSET * axis, node.means[rows] - _HALF_OFFSET * axis]),
            "quats": node.quats[rows].repeat(2, 1),
            "log_scales": smaller.repeat(2, 1),
            "logits": node.logits[rows].repeat(2),
            "codes": node.codes[rows].repeat(2, 1),
        }

    def _clear(self) -> None:
        self._gradient_sum, self._render_count = (
            torch.zeros(len(self._node), device=self._node.means.device) for _ in range(2)
        )

    def state(self) -> dict[str, Tensor]:
        """Return the statistics as tensors, for a checkpoint."""
        return {"pull": self._gradient_sum, "drawn": self._render_count, "first": torch.tensor(self._initial_count)}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        self._gradient_sum, self._render_count, self._initial_count = (
            state["pull"].clone().to(self._node.means.device),
            state["drawn"].clone().to(self._node.means.device),
            int(state["first"]),
        )


def _rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors (N, 3) by quaternions (N, 4), scalar first, of any length."""
    unit = functional.normalize(quats, dim=1)
    real, imaginary = unit[:, :1], unit[:, 1:]
    twice = 2.0 * torch.linalg.cross(imaginary, vectors)
    return vectors + real * twice + torch.linalg.cross(imaginary, twice)
