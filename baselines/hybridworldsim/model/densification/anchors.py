"""Anchors are added where images pull, in empty cells, and removed where nothing is seen of them."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from hybridworldsim.model.densification.cells import grow_anchors
from hybridworldsim.model.densification.schedule import target_count
from hybridworldsim.model.lazy_adam import LazyAdam
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.settings import Refinement
from hybridworldsim.model.splats import Splats
from hybridworldsim.training.viewpoint import Viewpoint

_SEEN = 10
_DRAWN = 2.0
_SPREAD = 0.5


class AnchorRefiner:
    """Keeps what images tell of anchors, and acts on it; after Scaffold-GS, with a budget in place of thresholds.

    Args:
        node: the anchors, whose tables are replaced.
        tables: those, as they are learnt.
        refinement: how many there may be, and where.
    """

    def __init__(self, node: Anchors, tables: LazyAdam, refinement: Refinement) -> None:
        self._node, self._tables, self._refinement, self._first = node, tables, refinement, len(node)
        self._nearest = torch.full((len(node),), torch.inf)
        self._clear()

    def accumulate(self, part: Splats, rows: Tensor, pull: Tensor, viewpoint: Viewpoint) -> None:
        """Take one image into account.

        Args:
            part: what was decoded.
            rows: (M,) of it, that the image shows.
            pull: (M,) of each.
            viewpoint: the camera.
        """
        offsets = part.rows[rows]
        self._pull.view(-1).index_add_(0, offsets, pull)
        self._drawn.view(-1).index_add_(0, offsets, torch.ones_like(pull))
        self._opacity.index_add_(0, part.rows // self._node.k, part.opacities.detach())
        if part.anchor_ids is not None:
            self._seen[part.anchor_ids] += 1.0
            distance = (self._node.means[part.anchor_ids] - viewpoint.centre).norm(dim=1)
            self._nearest[part.anchor_ids] = torch.minimum(self._nearest[part.anchor_ids], distance)

    @torch.no_grad()
    def refine(self, done: int, generator: torch.Generator) -> None:
        """Prune and grow.

        Args:
            done: which refinement this is.
            generator: for the offsets of new anchors.
        """
        refinement = self._refinement
        gone = (self._seen >= _SEEN) & (self._opacity < refinement.least_opacity * self._seen)
        keep = (~gone).nonzero().squeeze(1)
        room = max(target_count(refinement, done, self._first, refinement.max_anchors) - len(keep), 0)
        added, nearest = self._added(room, generator)
        if gone.any() or len(nearest):
            self._tables.replace(keep, added)
            self._nearest = torch.cat([self._nearest[keep], nearest])
        self._clear()

    def _added(self, room: int, generator: torch.Generator) -> tuple[dict[str, Tensor], Tensor]:
        node, refinement = self._node, self._refinement
        often = max(_DRAWN, refinement.least_share * float(self._seen.max())) if len(self._seen) else _DRAWN
        mean = torch.where(self._drawn >= often, self._pull / self._drawn.clamp_min(1.0), 0.0).view(-1)
        rows = mean.nonzero().squeeze(1)
        parents = rows // node.k
        points = node.means[parents] + node.offsets.view(-1, 3)[rows] * node.log_scales[parents, :3].exp()
        least = refinement.least_cell * self._nearest[parents]
        centres, sizes, chosen = grow_anchors(points, mean[rows], least, node.means, refinement.cells_m, room)
        offsets = 2.0 * torch.rand(len(centres), node.k, 3, generator=generator) - 1.0
        tables = {
            "means": centres,
            "offsets": _SPREAD * offsets,
            "codes": node.codes[parents[chosen]],
            "log_scales": sizes.log()[:, None].repeat(1, 6),
        }
        return tables, self._nearest[parents[chosen]]

    def _clear(self) -> None:
        count, k = len(self._node), self._node.k
        self._pull, self._drawn = torch.zeros(count, k), torch.zeros(count, k)
        self._opacity, self._seen = torch.zeros(count), torch.zeros(count)

    def state(self) -> dict[str, Tensor]:
        """All that it keeps."""
        return {
            "pull": self._pull,
            "drawn": self._drawn,
            "opacity": self._opacity,
            "seen": self._seen,
            "nearest": self._nearest,
            "first": torch.tensor(self._first),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """The opposite of `state`."""
        self._pull, self._drawn = state["pull"].clone(), state["drawn"].clone()
        self._opacity, self._seen = state["opacity"].clone(), state["seen"].clone()
        self._nearest, self._first = state["nearest"].clone(), int(state["first"])
