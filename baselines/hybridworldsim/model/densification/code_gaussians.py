"""Code-Gaussians are split where images pull, and removed where they have become transparent."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.model.densification.schedule import target_count
from hybridworldsim.model.lazy_adam import LazyAdam
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians
from hybridworldsim.model.settings import Refinement
from hybridworldsim.model.splats import Splats

_DRAWN = 2.0
_APART = 0.6
_SMALLER = 1.6
_TRANSPARENT = 0.005


class CodeRefiner:
    """Keeps what images tell of Code-Gaussians, and acts on it.

    Args:
        node: whose tables are replaced.
        tables: those, as they are learnt.
        refinement: when.
        most: Gaussians, at most.
    """

    def __init__(self, node: CodeGaussians, tables: LazyAdam, refinement: Refinement, most: int) -> None:
        self._node, self._tables, self._refinement = node, tables, refinement
        self._first, self._most = len(node), most
        self._clear()

    def accumulate(self, part: Splats, rows: Tensor, pull: Tensor) -> None:
        """Take one image into account; see `AnchorRefiner.note`."""
        own = part.rows[rows]
        self._pull.index_add_(0, own, pull)
        self._drawn.index_add_(0, own, torch.ones_like(pull))

    @torch.no_grad()
    def refine(self, done: int) -> None:
        """Prune, and split those that are pulled at most in two along their longest axis.

        Args:
            done: which refinement this is.
        """
        node = self._node
        gone = node.logits.sigmoid() < _TRANSPARENT
        room = max(target_count(self._refinement, done, self._first, self._most) - len(node) + int(gone.sum()), 0)
        score = torch.where((self._drawn >= _DRAWN) & ~gone, self._pull / self._drawn.clamp_min(1.0), 0.0)
        best = torch.argsort(score, descending=True, stable=True)[:room]
        split = best[score[best] > 0.0]
        gone[split] = True
        if gone.any():
            self._tables.replace((~gone).nonzero().squeeze(1), self._halves(split))
        self._clear()

    def _halves(self, rows: Tensor) -> dict[str, Tensor]:
        node = self._node
        scales = node.log_scales[rows]
        long = functional.one_hot(scales.argmax(1), 3).to(scales.dtype)
        axis = _rotated(node.quats[rows], long * scales.exp())
        smaller = scales - long * torch.tensor(_SMALLER).log()
        return {
            "means": torch.cat([node.means[rows] + _APART * axis, node.means[rows] - _APART * axis]),
            "quats": node.quats[rows].repeat(2, 1),
            "log_scales": smaller.repeat(2, 1),
            "logits": node.logits[rows].repeat(2),
            "codes": node.codes[rows].repeat(2, 1),
        }

    def _clear(self) -> None:
        self._pull, self._drawn = torch.zeros(len(self._node)), torch.zeros(len(self._node))

    def state(self) -> dict[str, Tensor]:
        """All that it keeps."""
        return {"pull": self._pull, "drawn": self._drawn, "first": torch.tensor(self._first)}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """The opposite of `state`."""
        self._pull, self._drawn, self._first = state["pull"].clone(), state["drawn"].clone(), int(state["first"])


def _rotated(quats: Tensor, vectors: Tensor) -> Tensor:
    """Vectors (N, 3) turned by rotations (N, 4), scalar first, of any length."""
    unit = functional.normalize(quats, dim=1)
    real, imaginary = unit[:, :1], unit[:, 1:]
    twice = 2.0 * torch.linalg.cross(imaginary, vectors)
    return vectors + real * twice + torch.linalg.cross(imaginary, twice)
