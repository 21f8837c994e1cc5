"""Every number of a method of explicit Gaussians; schedules are shares of progress, since a budget may be time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from hybridworldsim.model.settings import Rate, require, require_above
from mirror.errors import UsageError


@dataclass(frozen=True)
class LearningRates:
    """Learning rates of Adam; those of 3DGS (gsplat's `simple_trainer`) on a block of some 50 m.

    Attributes:
        means: metres a step.
        quats: of rotations.
        scales: of logarithms.
        opacities: of logits.
        sh0: of the constant band of colour.
        shN: of the others.
        adapter: of what a traversal adds to the constant band, where a method has that.
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
    """What training begins with: the points of the street's own beginning.

    Attributes:
        most: background points, thinned to so many at most.
        spacing_m: and to one a cell of this size.
        share: but no closer than this share of the distance from where vehicles drive.
        size: a Gaussian begins with this share of the distance to its neighbours.
        opacity: of a point's Gaussian.
        ground_spacing_m: of the grid on the ground.
        ground_reach_m: how far from a driven line there is ground.
        sky_count: Gaussians on the hemisphere.
        sky_radii: of the hemisphere, in block radii.
        far_count: points beyond the block, at most.
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
    """When gsplat's `DefaultStrategy` adds and removes Gaussians, and which.

    Attributes:
        begin: progress.
        end: progress.
        rounds: in between.
        resets: of opacities, in between; each `rounds / resets` rounds but for the last.
        most: Gaussians in the end, at most; it rises to this evenly.
        gradient: grow where the mean gradient in the image, in half widths of it, exceeds this.
        split_m: those larger are split, others doubled.
        least_opacity: below it, a Gaussian goes.
        largest_m: above it, a Gaussian goes, once opacities have been reset; None: never.
        absolute: sum gradients of pixels without their signs (AbsGS).
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
    """Of losses.

    Attributes:
        structure: share w of 1 - SSIM; the pixelwise loss has 1 - w.
        pixelwise: mean absolute or mean square difference.
        depth: of the depth loss; 0: none.
        depth_kind: "share" of the depth, squared, as the street's; "inverse", absolute, in 1/m; "metres", absolute.
        normal: of the street's loss of normals; 0: none.
        normal_every: it is computed at each so many-th step, with so many times the weight.
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
    """What all methods of explicit Gaussians have.

    Attributes:
        seeding: what training begins with.
        rates: learning rates.
        densification: of the Gaussians.
        weights: of losses.
        sh_degree: of colours, in the end.
        sh_step: one more band each time that progress is through so large a share.
        antialiased: opacities shrink by what the rasterizer's blur widened.
        near_m: Gaussians nearer are not drawn.
        seed: of everything that is left to chance.
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
