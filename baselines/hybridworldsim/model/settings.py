"""All numbers of the model and its training that the paper leaves open, or that a small budget scales."""

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
        """Return the rate at a progress from 0 to 1."""
        return float(self.first ** (1.0 - progress) * self.last**progress)


@dataclass(frozen=True)
class ModelLearningRates:
    """Learning rates of Adam: about twice the rates of Scaffold-GS and 3DGS, for small budgets."""

    means: Rate = Rate(1e-2, 1e-4)
    quats: Rate = Rate(1e-3, 1e-4)
    log_scales: Rate = Rate(1.4e-2, 1.4e-3)
    logits: Rate = Rate(5e-2, 5e-3)
    codes: Rate = Rate(2e-2, 2e-3)
    offsets: Rate = Rate(2e-2, 2e-4)
    networks: Rate = Rate(1e-2, 4e-4)
    latents: Rate = Rate(2e-2, 1e-3)


@dataclass(frozen=True)
class AnchorRefinement:
    """The schedule that adds and removes anchors, and the largest number of anchors.

    Attributes:
        begin: progress at which refinement begins.
        end: progress at which it ends.
        times: number of refinements in between.
        least_steps: smallest number of steps between two refinements.
        max_anchors: largest number of anchors in a block; the initial anchors stay, see `Settings.first_anchors`. Its
            key in ``run.json``, and in the hash of the settings, is ``most``.
        most_ground: largest number of Code-Gaussians on the ground.
        most_sky: largest number of Code-Gaussians in the sky.
        cells_m: sizes of cells for new anchors, coarse to fine.
        least_cell: smallest cell, as a share of the smallest distance of a camera to the anchor.
        least_opacity: an anchor whose opacities sum to less than this, on average over its visits, is removed.
        least_share: an offset counts only if at least this share of the images since the last refinement shows it.
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
        latent: size of an appearance latent; with 0 all traversals have the same appearance.
        hybrid: the background is represented by anchors; False: by Code-Gaussians, as ground and sky are.
        code: size of an anchor's code.
        offsets: number of Gaussians of an anchor.
        hidden: width of the networks.
        plain_code: size of the codes of ground and sky.
        first_anchors: largest number of initial points after thinning.
        first_spacing_m: smallest cell that keeps one initial point.
        first_share: a cell is at least this share of the distance to the nearest driven place.
        ground_spacing_m: step of the grid on the ground.
        ground_reach_m: largest distance of the ground from a driven line.
        sky_count: number of Gaussians on the hemisphere.
        sky_radius: radius of the hemisphere, in block radii.
        far_count: largest number of points beyond the block; they belong to the sky node.
        structure_weight: weight of the structure loss, which the paper does not have.
        depth_weight: weight of the depth loss.
        normal_weight: weight of the normal loss.
        normal_every: the normal loss is computed every so many steps, with its weight times this number.
        rates: learning rates.
        refinement: schedule and limits of refinement.
        seed: seed of all random numbers.
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
    rates: ModelLearningRates = field(default_factory=ModelLearningRates)
    refinement: AnchorRefinement = field(default_factory=AnchorRefinement)
    seed: int = 0

    def __post_init__(self) -> None:
        counts = ("code", "offsets", "hidden", "plain_code", "first_anchors", "sky_count", "sky_radius", "normal_every")
        require(self, "", counts, 1)
        require_above(self, "", ("first_spacing_m", "ground_spacing_m"))


@dataclass(frozen=True)
class LightSettings(Settings):
    """The model with the light of its recordings.

    Attributes:
        headlights: vehicles that were recorded by dusk and at night light the street before them.
    """

    headlights: bool = True


def require(settings: object, under: str, names: Sequence[str], least: float) -> None:
    """Raise an error unless all named settings are at least a number.

    Raises:
        UsageError: a setting is smaller.
    """
    for name in names:
        if not getattr(settings, name) >= least:
            raise UsageError(
                f"{getattr(settings, name)}", place=f"setting {under}{name}", expected=f"{least:g} or more"
            )


def require_above(settings: object, under: str, names: Sequence[str], least: float = 0.0) -> None:
    """Raise an error unless all named settings, or all their numbers, are larger than a number.

    Raises:
        UsageError: a setting is not larger.
    """
    for name in names:
        value = getattr(settings, name)
        if not all(number > least for number in (value if isinstance(value, tuple) else (value,))):
            raise UsageError(f"{value}", place=f"setting {under}{name}", expected=f"more than {least:g}")
