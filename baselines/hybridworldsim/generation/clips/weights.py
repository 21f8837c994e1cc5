"""The weight of each pixel of a clip in the loss of a training."""

from __future__ import annotations

from typing import Final

import numpy as np

from hybridworldsim.generation.clips.clip import ABSENT, Clip
from mirror.arrays import Float32

RULE: Final = (
    "1 on road users with a box, 0 on excluded pixels, elsewhere 1 less the share of training images in which a road"
    " user hides the place"
)
"""The rule of `pixel_weights` in words."""


def pixel_weights(clip: Clip) -> Float32 | None:
    """Return the weight (F, V, H, W) of each pixel; None if all pixels count equally.

    A road user with a box counts 1, an excluded pixel 0. Any other pixel counts 1 less the share of the static model's
    training images in which a road user hides its place: a background that no image could correct teaches nothing.
    """
    if clip.excluded is None and clip.hidden is None:
        return None
    weights = np.ones(clip.images.shape[:-1], np.float32)
    if clip.hidden is not None:
        weights -= clip.hidden / np.float32(255.0)
    if clip.tracks is not None:
        weights[clip.tracks != ABSENT] = 1.0
    if clip.excluded is not None:
        weights[clip.excluded] = 0.0
    return weights
