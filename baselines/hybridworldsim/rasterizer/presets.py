"""In what gsplat's generations differ, and the constants that they share.

Read from gsplat's CUDA sources: releases 1.3.0 (commit 507f26e1), 1.4.0 (4d3a3b69), 1.5.3 (937e2991) and 1.6.0
(1db12c01).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mirror.errors import UsageError

Extent = Literal["square", "ellipse"]
"""`square`: the square of three sigmas of the longer axis, rounded out to tiles, truncates the Gaussian, whatever its
opacity (to 1.4). `ellipse`: wherever alpha reaches `ALPHA_MIN` (from 1.5 on)."""

ALPHA_MIN = 1.0 / 255.0
"""A Gaussian whose alpha is smaller at a pixel is skipped there."""

TRANSMITTANCE_STOP = 1e-4
"""A Gaussian that would leave no more of the light ends its pixel, and is not blended."""

SQUARE_SIGMAS = 3.0
"""Half the `square` extent in standard deviations."""

SQUARE_DISCRIMINANT_MIN = 0.01
"""Floor under (trace / 2)^2 - det, pixel^4, in the longer axis of the `square` extent."""

QUATERNION_MIN, QUATERNION_MAX = 1e-30, 1e150
"""Lengths between which a quaternion is a rotation: below, its gradient would leave float32, above, its square float64.
Others are degenerate, and culled. (gsplat's kernels square in float32: beyond 1e-19 to 1e19 their rotations are NaN or
no rotations.)"""


@dataclass(frozen=True, kw_only=True)
class Preset:
    """One generation of gsplat.

    Attributes:
        name: as `rasterization` takes it.
        releases: the releases of gsplat that render this way, major and minor number.
        extent: which pixels a Gaussian can reach.
        alpha_max: cap of alpha; where it holds, no gradient passes to opacity and shape.
        compensation_min: floor of the factor by which antialiasing shrinks opacities; no gradient passes below it.
    """

    name: str
    releases: tuple[str, ...]
    extent: Extent
    alpha_max: float
    compensation_min: float


PRESETS = {
    preset.name: preset
    for preset in (
        Preset(name="gsplat-1.3", releases=("1.3", "1.4"), extent="square", alpha_max=0.999, compensation_min=0.0),
        Preset(name="gsplat-1.5", releases=("1.5",), extent="ellipse", alpha_max=0.999, compensation_min=0.0),
        # alpha's cap since commit c5ff586b, compensation's floor since 421f7698
        Preset(name="gsplat-1.6", releases=("1.6",), extent="ellipse", alpha_max=0.99, compensation_min=0.005),
    )
}
DEFAULT_PRESET = "gsplat-1.5"


def get_preset(name: str) -> Preset:
    """The preset of a name.

    Args:
        name: a key of `PRESETS`.

    Raises:
        UsageError: there is no preset of this name.
    """
    if name not in PRESETS:
        raise UsageError(f"no preset {name!r}", place="preset", expected=" or ".join(PRESETS))
    return PRESETS[name]
