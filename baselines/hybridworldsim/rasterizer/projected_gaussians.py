"""The projection of Gaussians into one camera: the ellipses that are blended."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class ProjectedGaussians(NamedTuple):
    """The M Gaussians that reach an image, by ascending index.

    The CPU backend gives float32, and float64 for `conics` and `factors`; the reference gives float64. `means2d`,
    `depths`, `conics` and `compensations` have gradients.

    Attributes:
        ids: (M,) int64, indices among all Gaussians.
        means2d: (M, 2) pixels.
        means2d_low: (M, 2) rounding errors of the means; the sum with `means2d` is exact to 1e-8 pixels.
        depths: (M,) camera z, metres.
        conics: (M, 3) xx, xy, yy of the inverse of the blurred covariance, 1 / pixel^2; float64, because the gradient
            to a Gaussian of aspect ratio a loses a^2 of precision by cancellation.
        factors: (M, 3) f11, f12, f22 of the conic's quadratic form (f11 dx + f12 dy)^2 + (f22 dy)^2. For a needle the
            form cancels in xx, xy and yy, and does not in the factors. Float64, because f12 / f11 is the direction.
        compensations: (M,) factors that reduce opacities if antialiased; None if not.
        radii: (M, 2) int32, half the extent in pixels.
        counts: numbers of culled Gaussians, by cause.
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
