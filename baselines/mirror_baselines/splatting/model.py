"""The model of a method of explicit Gaussians: tables with a row a Gaussian, and what gives them colours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import torch
from torch import Tensor, nn

from hybridworldsim.model.visible import select_visible
from hybridworldsim.training.viewpoint import Source, Viewpoint
from mirror_baselines.splatting.appearance import AppearanceModel

GEOMETRY: Final = ("means", "quats", "scales", "opacities")
_SIGMAS = 3.33


class Gaussians(nn.Module):
    """Explicit Gaussians.

    Args:
        seeds: what it begins with, see `mirror_baselines.splatting.gaussian_init.initial_gaussians`.
        look: how they get colours.
    """

    def __init__(self, seeds: Mapping[str, Tensor], look: AppearanceModel) -> None:
        super().__init__()
        tables = {**seeds, **look.tables(len(seeds["means"]))}
        self.tables = nn.ParameterDict({name: nn.Parameter(table) for name, table in tables.items()})
        self.look = look
        # A parameter, though nothing learns it: whoever renders needs it.
        self.sh_degree = nn.Parameter(torch.tensor(0), requires_grad=False)

    def __len__(self) -> int:
        return len(self.tables["means"])

    def visible_ids(self, viewpoint: Viewpoint) -> Tensor:
        """(M,) int64: rows that a viewpoint may see."""
        reach = _SIGMAS * self.tables["scales"].detach().amax(1).exp()
        return select_visible(viewpoint, self.tables["means"].detach(), reach)

    def geometry(self, rows: Tensor) -> dict[str, Tensor]:
        """Rows of the tables of geometry, copied: their gradients are as small as what is seen."""
        return {name: self.tables[name].detach().index_select(0, rows) for name in GEOMETRY}

    def harmonics(self, rows: Tensor, source: Source) -> Tensor:
        """(M, (degree + 1)^2, 3) of rows as a source sees them, copied too."""
        degree = int(self.sh_degree)
        found = torch.empty(len(rows), (degree + 1) ** 2, 3)
        filled = 0
        for name, first, past in self.look.bands(source, degree):
            part = self.tables[name].detach()[:, : past - first]
            if first == filled:
                torch.index_select(part, 0, rows, out=found[:, first:past])
                filled = past
            else:
                found[:, first:past] += part.index_select(0, rows)
        return found
