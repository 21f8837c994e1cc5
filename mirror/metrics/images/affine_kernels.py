"""The compiled part of `psnr_affine` of 8-bit images: one pass that tallies the truth by the render's level."""

from __future__ import annotations

from numba import njit

from mirror.arrays import Bool, Int64, UInt8

_WHITE = 255


@njit(cache=True, nogil=True)
def tally_levels(render: UInt8, truth: UInt8, mask: Bool | None, out: Int64) -> None:
    """Add up the truth at each level of the render.

    Args:
        render: (H, W, C).
        truth: (H, W, C).
        mask: (H, W), True where pixels count; None: all do.
        out: (C, 256, 5), added to: pixels, sum and sum of squares of the truth; pixels and sum of the truth of those
            that are saturated (0 or 255) in neither image.
    """
    for row in range(render.shape[0]):
        for column in range(render.shape[1]):
            if mask is not None and not mask[row, column]:
                continue
            for channel in range(render.shape[2]):
                x, y = render[row, column, channel], int(truth[row, column, channel])
                tally = out[channel, x]
                tally[0] += 1
                tally[1] += y
                tally[2] += y * y
                if 0 < x < _WHITE and 0 < y < _WHITE:
                    tally[3] += 1
                    tally[4] += y
