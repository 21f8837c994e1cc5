"""The result of blending: an image and its counts."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class BlendedImage(NamedTuple):
    """The image of one camera before a background is added.

    Float32 from the CPU backend, float64 from the reference. `image` and `alpha` have gradients.

    Attributes:
        image: (H, W, D) sum of weight times feature.
        alpha: (H, W) sum of weights: one minus the remaining transmittance.
        counts: numbers of `pairs` of tile and Gaussian, of `processed_pairs`, and of `stopped_tiles`.
    """

    image: Tensor
    alpha: Tensor
    counts: dict[str, int]
