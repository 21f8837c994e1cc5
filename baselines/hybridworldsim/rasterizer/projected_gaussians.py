"""What one camera sees of a set of Gaussians: the ellipses that are blended."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class ProjectedGaussians(NamedTuple):
    """The M Gaussians that reach a picture, by ascending index.

    Float32 of the CPU backend but for `conics` and `factors`, float64 of the reference. `means2d`, `depths`, `conics`
    and `compensations` carry gradients.

    Attributes:
        ids: (M,) int64, index of each among all Gaussians.
        means2d: (M, 2) pixels.
        means2d_low: (M, 2) what rounding took from the means: their sum is exact to 1e-8 pixels.
        depths: (M,) camera z, metres.
        conics: (M, 3) xx, xy, yy of the inverse of the blurred covariance, 1 / pixel^2; float64, because the way back
            from their gradient to that of a Gaussian of aspect ratio a cancels by a^2.
        factors: (M, 3) f11, f12, f22 of the conic's quadratic form (f11 dx + f12 dy)^2 + (f22 dy)^2: a needle's form
            cancels in xx, xy and yy, not in these; float64, because f12 / f11 is the needle's direction.
        compensations: (M,) by which opacities shrink if antialiased; None if not.
        radii: (M, 2) int32, half the extent in pixels.
        counts: how many Gaussians were culled, by cause.
    """

    ids: Tensor
    means2d: Tensor
    means2d_low: Tensor
    depths: Tensor
    conics: Tensor
    factors: Tensor
    compensations: Tensor | None
    radii: Tensor
    counts: dict[str, int]
