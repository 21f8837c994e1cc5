"""The model of a method of explicit Gaussians: tables with a row for each Gaussian, and an appearance model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import torch
from torch import Tensor, nn

from hybridworldsim.model.visible import select_visible
from hybridworldsim.trainable.viewpoint import Source, Viewpoint
from mirror_baselines.splatting.appearance import AppearanceModel
from mirror_baselines.splatting.kept_parameters import KeepsParameters

GEOMETRY: Final = ("means", "quats", "scales", "opacities")
_SIGMAS = 3.33


class Gaussians(KeepsParameters):
    """A model of explicit Gaussians, each with its own parameters.

    Args:
        seeds: initial parameters, see `mirror_baselines.splatting.gaussian_init.initial_gaussians`.
        appearance: computes their colours.
    """

    KEPT: ClassVar = ("sh_degree",)

    def __init__(self, seeds: Mapping[str, Tensor], appearance: AppearanceModel) -> None:
        super().__init__()
        tables = {**seeds, **appearance.tables(len(seeds["means"]))}
        self.tables = nn.ParameterDict({name: nn.Parameter(table) for name, table in tables.items()})
        # Stored models name the parameters of this module "look.*".
        self.look = appearance
        # A parameter without gradient, so that it is stored with the model.
        self.sh_degree = nn.Parameter(torch.tensor(0), requires_grad=False)

    def __len__(self) -> int:
        return len(self.tables["means"])

    def visible_ids(self, viewpoint: Viewpoint) -> Tensor:
        """Return the rows (M,) that a viewpoint may see, int64."""
        reach = _SIGMAS * self.tables["scales"].detach().amax(1).exp()
        return select_visible(viewpoint, self.tables["means"].detach(), reach)

    def geometry(self, rows: Tensor) -> dict[str, Tensor]:
        """Copy rows of the tables of geometry, so that gradients exist for these rows only."""
        return {name: self.tables[name].detach().index_select(0, rows) for name in GEOMETRY}

    def spherical_harmonics(self, rows: Tensor, source: Source) -> Tensor:
        """Copy the coefficients (M, (degree + 1)^2, 3) of rows for a source."""
        degree = int(self.sh_degree)
        coefficients = torch.empty(len(rows), (degree + 1) ** 2, 3, device=rows.device)
        filled = 0
        for name, first, past in self.look.bands(source, degree):
            part = self.tables[name].detach()[:, : past - first]
            if first == filled:
                torch.index_select(part, 0, rows, out=coefficients[:, first:past])
                filled = past
            else:
                coefficients[:, first:past] += part.index_select(0, rows)
        return coefficients
