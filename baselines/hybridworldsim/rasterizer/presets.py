"""The differences between gsplat's generations, and the constants that they share.

Source: gsplat's CUDA sources: releases 1.3.0 (commit 507f26e1), 1.4.0 (4d3a3b69), 1.5.3 (937e2991) and 1.6.0
(1db12c01).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mirror.errors import UsageError

Extent = Literal["square", "ellipse"]
"""The pixels that a Gaussian reaches. `square`: the tiles that touch the square of three sigmas of the longer axis, for
any opacity (up to 1.4). `ellipse`: all pixels at which alpha reaches `ALPHA_MIN` (from 1.5 on)."""

ALPHA_MIN = 1.0 / 255.0
"""A Gaussian with a smaller alpha at a pixel is skipped at that pixel."""

TRANSMITTANCE_STOP = 1e-4
"""A pixel ends in front of the Gaussian that would reduce its transmittance to this value or less."""

SQUARE_SIGMAS = 3.0
"""Half the `square` extent in standard deviations."""

SQUARE_DISCRIMINANT_MIN = 0.01
"""Lower bound of (trace / 2)^2 - det, pixel^4, in the longer axis of the `square` extent."""

QUATERNION_MIN, QUATERNION_MAX = 1e-30, 1e150
"""Range of lengths in which a quaternion is a rotation. Below it the gradient would exceed float32, above it the
squared length would exceed float64. Other quaternions are degenerate and culled. (gsplat's kernels square in float32:
outside 1e-19 to 1e19 their rotations are NaN or wrong.)"""


@dataclass(frozen=True, kw_only=True)
class GsplatPreset:
    """One generation of gsplat.

    Attributes:
        name: value of the argument `preset`.
        releases: releases of gsplat that follow this preset, major and minor number.
        extent: rule for the pixels that a Gaussian reaches.
        alpha_max: upper bound of alpha; at the bound opacity and shape get no gradient.
        compensation_min: lower bound of the factor by which antialiasing reduces opacities; at the bound there is no
            gradient.
    """

    name: str
    releases: tuple[str, ...]
    extent: Extent
    alpha_max: float
    compensation_min: float


PRESETS = {
    preset.name: preset
    for preset in (
        GsplatPreset(
            name="gsplat-1.3", releases=("1.3", "1.4"), extent="square", alpha_max=0.999, compensation_min=0.0
        ),
        GsplatPreset(name="gsplat-1.5", releases=("1.5",), extent="ellipse", alpha_max=0.999, compensation_min=0.0),
        # alpha's cap since commit c5ff586b, compensation's floor since 421f7698
        GsplatPreset(name="gsplat-1.6", releases=("1.6",), extent="ellipse", alpha_max=0.99, compensation_min=0.005),
    )
}
DEFAULT_PRESET = "gsplat-1.5"


def get_preset(name: str) -> GsplatPreset:
    """Get the preset of a name.

    Args:
        name: a key of `PRESETS`.

    Raises:
        UsageError: there is no preset of this name.
    """
    if name not in PRESETS:
        raise UsageError(f"no preset {name!r}", place="preset", expected=" or ".join(PRESETS))
    return PRESETS[name]
