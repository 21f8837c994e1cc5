"""What blending gives: a picture, and what it took."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class BlendedImage(NamedTuple):
    """One camera's picture before a background is added.

    Float32 of the CPU backend, float64 of the reference. `image` and `alpha` carry gradients.

    Attributes:
        image: (H, W, D) sum of weight times feature.
        alpha: (H, W) sum of weights: one minus the light that passes all.
        counts: what was done: `pairs` of tile and Gaussian, `processed_pairs` of them, `stopped_tiles`.
    """

    image: Tensor
    alpha: Tensor
    counts: dict[str, int]
