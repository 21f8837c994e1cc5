"""Images that are missing from a camera's sequence: a camera with a regular rate leaves a pause where one is lost."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Int64

PAUSE_PERIODS: Final = 1.5
"""A pause is a step between two images of more than this many periods, as in the rule TIM005 of `mirror check`."""


def count_missing_images(stamps_ns: Int64) -> int:
    """Return the number of images, at a camera's own rate, that fit into the camera's pauses.

    The period is the median step. A pause of n periods counts as n - 1 missing images. Images that are missing before
    the first or after the last image leave no pause and are not counted.

    Args:
        stamps_ns: (N,) ascending stamps of the images.
    """
    steps = np.diff(stamps_ns)
    if not len(steps):
        return 0
    period = float(np.median(steps))
    pauses = steps[steps > PAUSE_PERIODS * period] if period > 0 else steps[:0]
    return int((np.rint(pauses / period) - 1).sum())
