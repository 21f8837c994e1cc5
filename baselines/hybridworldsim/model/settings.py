"""Every number of the model and of its training that the paper leaves open, or that a small budget scales."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import AliasChoices, Field

from mirror.errors import UsageError


@dataclass(frozen=True)
class Rate:
    """A learning rate that falls geometrically.

    Attributes:
        first: at progress 0.
        last: at progress 1.
    """

    first: float
    last: float

    def at(self, progress: float) -> float:
        """The rate at a progress from 0 to 1."""
        return float(self.first ** (1.0 - progress) * self.last**progress)


@dataclass(frozen=True)
class LearningRates:
    """Learning rates of Adam: about twice those of Scaffold-GS and of 3DGS, as small budgets want it."""

    means: Rate = Rate(1e-2, 1e-4)
    quats: Rate = Rate(1e-3, 1e-4)
    log_scales: Rate = Rate(1.4e-2, 1.4e-3)
    logits: Rate = Rate(5e-2, 5e-3)
    codes: Rate = Rate(2e-2, 2e-3)
    offsets: Rate = Rate(2e-2, 2e-4)
    networks: Rate = Rate(1e-2, 4e-4)
    latents: Rate = Rate(2e-2, 1e-3)


@dataclass(frozen=True)
class Refinement:
    """When anchors are added and removed, and how many there may be.

    Attributes:
        begin: progress.
        end: progress.
        times: how often in between.
        least_steps: but not before so many images told something since the last time.
        max_anchors: largest number of anchors in a block; those that it begins with stay, see `Settings.first_anchors`.
            Its key in ``run.json``, and in the hash of the settings, is ``most``.
        most_ground: Code-Gaussians on the ground, at most.
        most_sky: and in the sky.
        cells_m: sizes of cells in which new anchors stand, coarse to fine.
        least_cell: a cell is no smaller than this share of the distance from which it is seen at nearest.
        least_opacity: mean sum of an anchor's opacities below which it goes.
        least_share: an offset counts that so large a share of the images since the last time drew.
    """

    begin: float = 0.05
    end: float = 0.6
    times: int = 40
    least_steps: int = 20
    max_anchors: Annotated[
        int, Field(validation_alias=AliasChoices("max_anchors", "most"), serialization_alias="most")
    ] = 36_000
    most_ground: int = 20_000
    most_sky: int = 5_000
    cells_m: tuple[float, ...] = (1.6, 0.4, 0.1)
    least_cell: float = 0.01
    least_opacity: float = 0.005
    least_share: float = 0.01

    def __post_init__(self) -> None:
        require(self, "refinement.", ("most_ground", "most_sky"), 1)
        require_above(self, "refinement.", ("cells_m",))
        if not (self.begin < self.end <= 1.0 and self.cells_m):
            raise UsageError(
                f"from {self.begin:g} to {self.end:g}, in cells of {self.cells_m} m",
                place="settings refinement.begin, refinement.end, refinement.cells_m",
                expected="begin below end, end 1 at most, one size of cells or more",
            )


@dataclass(frozen=True)
class Settings:
    """The model and its training.

    Attributes:
        latent: size of an appearance; 0: all traversals look the same.
        hybrid: the background is of anchors; False: of Code-Gaussians, as ground and sky are.
        code: size of an anchor's code.
        offsets: Gaussians an anchor.
        hidden: width of the networks.
        plain_code: size of the codes of ground and sky.
        first_anchors: the initial points are thinned to so many at most.
        first_spacing_m: and to one a cell of this size.
        first_share: but no closer than this share of the distance from where vehicles drive.
        ground_spacing_m: of the grid on the ground.
        ground_reach_m: how far from a driven line there is ground.
        sky_count: Gaussians on the hemisphere.
        sky_radius: of the hemisphere, in block radii.
        far_count: of the points beyond the block, which the sky takes in, so many at most.
        structure_weight: of the loss of structure, which the paper does not have.
        depth_weight: of the depth loss.
        normal_weight: of the normal loss.
        normal_every: it is computed at each so many-th step, with so many times the weight.
        rates: learning rates.
        refinement: of the anchors.
        seed: of everything that is left to chance.
    """

    latent: int = 32
    hybrid: bool = True
    code: int = 32
    offsets: int = 3
    hidden: int = 64
    plain_code: int = 16
    first_anchors: int = 28_000
    first_spacing_m: float = 0.2
    first_share: float = 0.02
    ground_spacing_m: float = 0.5
    ground_reach_m: float = 15.0
    sky_count: int = 1_500
    sky_radius: float = 4.0
    far_count: int = 2_000
    structure_weight: float = 0.0
    depth_weight: float = 0.04
    normal_weight: float = 1e-5
    normal_every: int = 4
    rates: LearningRates = field(default_factory=LearningRates)
    refinement: Refinement = field(default_factory=Refinement)
    seed: int = 0

    def __post_init__(self) -> None:
        counts = ("code", "offsets", "hidden", "plain_code", "first_anchors", "sky_count", "sky_radius", "normal_every")
        require(self, "", counts, 1)
        require_above(self, "", ("first_spacing_m", "ground_spacing_m"))


def require(settings: object, under: str, names: Sequence[str], least: float) -> None:
    """See that settings are not below the least that there can be.

    Raises:
        UsageError: one is.
    """
    for name in names:
        if not getattr(settings, name) >= least:
            raise UsageError(
                f"{getattr(settings, name)}", place=f"setting {under}{name}", expected=f"{least:g} or more"
            )


def require_above(settings: object, under: str, names: Sequence[str], least: float = 0.0) -> None:
    """See that settings, or all numbers of each, are above something.

    Raises:
        UsageError: one is not.
    """
    for name in names:
        value = getattr(settings, name)
        if not all(number > least for number in (value if isinstance(value, tuple) else (value,))):
            raise UsageError(f"{value}", place=f"setting {under}{name}", expected=f"more than {least:g}")
