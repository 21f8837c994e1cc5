"""Selects images taken in motion: images of a stationary vehicle add neither training data nor evidence of depth."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Final

import numpy as np

from mirror.arrays import Float64

STATIONARY_M: Final = 0.25
"""Motion below which a camera counts as stationary, metres."""


def select_moving(images: Iterable[tuple[Hashable, Float64]], stationary_m: float = STATIONARY_M) -> list[int]:
    """Select the images whose camera has moved since its last selected image.

    Args:
        images: for each image a key of its camera and traversal, and its position (3,) in metres; the images of one
            camera are in order of time.
        stationary_m: a camera has moved if it is at least this far from its last selected image; 0 selects all.

    Returns:
        Indices of the selected images in the given order; the first image of each camera is always selected.
    """
    last: dict[Hashable, Float64] = {}
    selected = []
    for index, (camera, position) in enumerate(images):
        if camera in last and np.linalg.norm(position - last[camera]) < stationary_m:
            continue
        last[camera] = position
        selected.append(index)
    return selected
