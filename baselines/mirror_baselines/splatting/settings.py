"""All numbers of a method of explicit Gaussians; schedules are shares of progress, because a budget may be a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from hybridworldsim.methods.estimates import TableSizes
from hybridworldsim.model.settings import Rate, require, require_above
from mirror.errors import UsageError


@dataclass(frozen=True)
class LearningRates:
    """Learning rates of Adam: the rates of 3DGS (gsplat's `simple_trainer`) for a block of about 50 m.

    Attributes:
        means: metres per step.
        quats: of rotations.
        scales: of logarithms.
        opacities: of logits.
        sh0: of the constant band of colour.
        shN: of the other bands.
        adapter: of a traversal's part of the constant band, where a method has one.
    """

    means: Rate = field(default=Rate(8e-3, 8e-5))
    quats: Rate = field(default=Rate(1e-3, 1e-3))
    scales: Rate = field(default=Rate(5e-3, 5e-3))
    opacities: Rate = field(default=Rate(5e-2, 5e-2))
    sh0: Rate = field(default=Rate(2.5e-3, 2.5e-3))
    shN: Rate = field(default=Rate(1.25e-4, 1.25e-4))
    adapter: Rate | None = None


@dataclass(frozen=True)
class GaussianInit:
    """The initial Gaussians: the points with which a street begins.

    Attributes:
        most: largest number of background points after thinning.
        spacing_m: smallest cell that keeps one point.
        share: a cell is at least this share of the distance to the nearest driven place.
        size: initial size of a Gaussian, as a share of the distance to its neighbours.
        opacity: initial opacity of a point's Gaussian.
        ground_spacing_m: step of the grid on the ground.
        ground_reach_m: largest distance of the ground from a driven line.
        sky_count: number of Gaussians on the hemisphere.
        sky_radii: radius of the hemisphere, in block radii.
        far_count: largest number of points beyond the block.
    """

    most: int = 40_000
    spacing_m: float = 0.15
    share: float = 0.02
    size: float = 1.0
    opacity: float = 0.1
    ground_spacing_m: float = 0.35
    ground_reach_m: float = 15.0
    sky_count: int = 3_000
    sky_radii: float = 4.0
    far_count: int = 4_000

    def __post_init__(self) -> None:
        require(self, "seeding.", ("sky_radii",), 1)
        require_above(self, "seeding.", ("spacing_m", "ground_spacing_m", "size", "opacity"))
        if not self.opacity < 1.0:
            raise UsageError(f"{self.opacity:g}", place="setting seeding.opacity", expected="below 1")


@dataclass(frozen=True)
class Densification:
    """The schedule by which gsplat's `DefaultStrategy` adds and removes Gaussians.

    Attributes:
        begin: progress at which it begins.
        end: progress at which it ends.
        rounds: number of rounds in between.
        resets: number of opacity resets in between, one every `rounds / resets` rounds except the last.
        most: largest number of Gaussians at the end; the cap rises to it evenly.
        gradient: Gaussians grow where the mean image gradient, in units of half the width, is larger.
        split_m: larger Gaussians are split, others are doubled.
        least_opacity: Gaussians with a smaller opacity are removed.
        largest_m: larger Gaussians are removed once opacities have been reset; None: never.
        absolute: sum the gradients of pixels without their signs (AbsGS).
    """

    begin: float = 1.0 / 60.0
    end: float = 0.5
    rounds: int = 40
    resets: int = 5
    most: int = 100_000
    gradient: float = 2e-4
    split_m: float = 0.5
    least_opacity: float = 0.005
    largest_m: float | None = 5.0
    absolute: bool = False

    def __post_init__(self) -> None:
        if not self.begin < self.end <= 1.0:
            raise UsageError(
                f"from {self.begin:g} to {self.end:g}",
                place="settings densification.begin, densification.end",
                expected="begin below end, end 1 at most",
            )


@dataclass(frozen=True)
class Weights:
    """Weights of the losses of a training.

    Attributes:
        structure: weight w of 1 - SSIM; the pixelwise loss has the weight 1 - w.
        pixelwise: mean absolute or mean square difference.
        depth: weight of the depth loss; 0: none.
        depth_kind: "share": square of the error as a share of the depth, as for the street; "inverse": absolute error
            of the inverse depth, 1/m; "metres": absolute error.
        normal: weight of the street's normal loss; 0: none.
        normal_every: the normal loss is computed every so many steps, with its weight times this number.
    """

    structure: float = 0.2
    pixelwise: Literal["l1", "l2"] = "l1"
    depth: float = 0.0
    depth_kind: Literal["share", "inverse", "metres"] = "share"
    normal: float = 0.0
    normal_every: int = 4

    def __post_init__(self) -> None:
        require(self, "weights.", ("normal_every",), 1)


@dataclass(frozen=True)
class Splatting:
    """Settings of all methods of explicit Gaussians.

    Attributes:
        seeding: initial Gaussians.
        rates: learning rates.
        densification: densification of the Gaussians.
        weights: weights of losses.
        sh_degree: final degree of the spherical harmonics.
        sh_step: share of progress after which the degree rises by one.
        antialiased: lower opacities by as much as the rasterizer's blur widens Gaussians.
        near_m: nearer Gaussians are not rendered.
        seed: seed of all random numbers.
    """

    seeding: GaussianInit = field(default_factory=GaussianInit)
    rates: LearningRates = field(default_factory=LearningRates)
    densification: Densification = field(default_factory=Densification)
    weights: Weights = field(default_factory=Weights)
    sh_degree: int = 3
    sh_step: float = 1.0 / 30.0
    antialiased: bool = False
    near_m: float = 0.2
    seed: int = 0

    def __post_init__(self) -> None:
        require_above(self, "", ("sh_step", "near_m"))


def table_sizes(settings: Splatting) -> TableSizes:
    """Return the largest sizes of the tables of explicit Gaussians with shared harmonics.

    Tables that a method has for each traversal come on top.
    """
    most = max(settings.densification.most, settings.seeding.most)
    return TableSizes(most * (11 + 3 * (settings.sh_degree + 1) ** 2), most)
