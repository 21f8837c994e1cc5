"""Anchors are added in empty cells where image gradients are large, and removed where they stay transparent."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from hybridworldsim.model.dense_adam import DenseAdam, TableAdam
from hybridworldsim.model.densification.cells import grow_anchors
from hybridworldsim.model.densification.image_gradients import ImageGradients
from hybridworldsim.model.densification.schedule import target_count
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.plain.decoding import visible_mask
from hybridworldsim.model.settings import AnchorRefinement
from hybridworldsim.model.splats import DecodedSplats
from hybridworldsim.trainable.viewpoint import Viewpoint

_MIN_VISITS = 10
_MIN_RENDERS = 2.0
_SPREAD = 0.5


class AnchorRefiner:
    """A collector of statistics of anchors that refines them as in Scaffold-GS, with a cap in place of thresholds.

    Args:
        node: the anchors; their tables are replaced.
        tables: optimiser of the tables.
        refinement: how many anchors there may be, and in which cells.
    """

    def __init__(self, node: Anchors, tables: TableAdam, refinement: AnchorRefinement) -> None:
        self._node, self._tables, self._refinement, self._initial_count = node, tables, refinement, len(node)
        self._nearest_m = torch.full((len(node),), torch.inf, device=node.means.device)
        self._clear()

    def accumulate(self, part: DecodedSplats, gradients: ImageGradients, viewpoint: Viewpoint) -> None:
        """Add the statistics of one image.

        Args:
            part: the decoded Gaussians.
            gradients: image-plane gradients of Gaussians of the part.
            viewpoint: camera of the image.
        """
        offsets = part.rows[gradients.rows]
        self._gradient_sum.view(-1).index_add_(0, offsets, gradients.lengths)
        self._render_count.view(-1).index_add_(0, offsets, gradients.shown)
        parents, opacities = part.rows // self._node.k, part.opacities.detach()
        centre = viewpoint.centre.to(self._nearest_m.device, non_blocking=True)
        if isinstance(self._tables, DenseAdam):
            # All anchors were decoded: those that the viewpoint may see count. To select them would wait for a GPU.
            seen = visible_mask(viewpoint, self._node.means, self._node.reach_m())
            self._opacity_sum.index_add_(0, parents, torch.where(seen[parents], opacities, 0.0))
            self._visit_count += seen
            distance = (self._node.means - centre).norm(dim=1)
            self._nearest_m = torch.where(seen, torch.minimum(self._nearest_m, distance), self._nearest_m)
            return
        self._opacity_sum.index_add_(0, parents, opacities)
        if part.anchor_ids is not None:
            self._visit_count[part.anchor_ids] += 1.0
            distance = (self._node.means[part.anchor_ids] - centre).norm(dim=1)
            self._nearest_m[part.anchor_ids] = torch.minimum(self._nearest_m[part.anchor_ids], distance)

    @torch.no_grad()
    def refine(self, refinement_number: int, generator: torch.Generator) -> None:
        """Remove transparent anchors and add new ones.

        Args:
            refinement_number: number of this refinement, from 1.
            generator: random generator for the offsets of new anchors.
        """
        refinement = self._refinement
        is_removed = (self._visit_count >= _MIN_VISITS) & (
            self._opacity_sum < refinement.least_opacity * self._visit_count
        )
        keep = (~is_removed).nonzero().squeeze(1)
        free_count = max(
            target_count(refinement, refinement_number, self._initial_count, refinement.max_anchors) - len(keep), 0
        )
        added, nearest_m = self._grow(free_count, generator)
        if is_removed.any() or len(nearest_m):
            self._tables.replace(keep, added)
            self._nearest_m = torch.cat([self._nearest_m[keep], nearest_m])
        self._clear()

    def _grow(self, free_count: int, generator: torch.Generator) -> tuple[dict[str, Tensor], Tensor]:
        node, refinement = self._node, self._refinement
        min_renders = (
            max(_MIN_RENDERS, refinement.least_share * float(self._visit_count.max()))
            if len(self._visit_count)
            else _MIN_RENDERS
        )
        mean = torch.where(
            self._render_count >= min_renders, self._gradient_sum / self._render_count.clamp_min(1.0), 0.0
        ).view(-1)
        rows = mean.nonzero().squeeze(1)
        parents = rows // node.k
        points = node.means[parents] + node.offsets.view(-1, 3)[rows] * node.log_scales[parents, :3].exp()
        min_cell_m = refinement.least_cell * self._nearest_m[parents]
        centres, sizes, chosen = grow_anchors(
            points, mean[rows], min_cell_m, node.means, refinement.cells_m, free_count
        )
        offsets = (2.0 * torch.rand(len(centres), node.k, 3, generator=generator) - 1.0).to(centres.device)
        tables = {
            "means": centres,
            "offsets": _SPREAD * offsets,
            "codes": node.codes[parents[chosen]],
            "log_scales": sizes.log()[:, None].repeat(1, 6),
        }
        return tables, self._nearest_m[parents[chosen]]

    def _clear(self) -> None:
        count, k, device = len(self._node), self._node.k, self._node.means.device
        self._gradient_sum, self._render_count = (torch.zeros(count, k, device=device) for _ in range(2))
        self._opacity_sum, self._visit_count = (torch.zeros(count, device=device) for _ in range(2))

    def state(self) -> dict[str, Tensor]:
        """Return the statistics as tensors, for a checkpoint."""
        return {
            "pull": self._gradient_sum,
            "drawn": self._render_count,
            "opacity": self._opacity_sum,
            "seen": self._visit_count,
            "nearest": self._nearest_m,
            "first": torch.tensor(self._initial_count),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        device = self._node.means.device
        self._gradient_sum, self._render_count = state["pull"].clone().to(device), state["drawn"].clone().to(device)
        self._opacity_sum, self._visit_count = state["opacity"].clone().to(device), state["seen"].clone().to(device)
        self._nearest_m, self._initial_count = state["nearest"].clone().to(device), int(state["first"])
