"""Smoothing of a cost volume along paths: depths of neighbours cost where they differ.

Hirschmueller, "Stereo processing by semiglobal matching and mutual information" (TPAMI 2008), with four paths.
"""

from __future__ import annotations

import numba
import numpy as np

from hybridworldsim.mvs.sweep.correlation import UNKNOWN
from mirror.arrays import AnyArray, Float32, UInt8


def smoothed(volume: UInt8, grey: Float32, *, step: int, jump: int, neutral: int, contrast: float) -> AnyArray:
    """The costs (H, W, D) int32 summed over the four paths through each pixel.

    Args:
        volume: (H, W, D) costs; `UNKNOWN` where there is none.
        grey: (H, W) the picture; a jump costs less where it changes. NaN changes everything.
        step: what a change of depth by one costs.
        jump: what any larger change costs at most.
        neutral: what an unknown cost counts as.
        contrast: change of grey at which a jump costs half.
    """
    return np.asarray(_smooth(volume, np.nan_to_num(grey, nan=9.0), step, jump, neutral, contrast))


@numba.njit(cache=True, parallel=True, nogil=True)
def _smooth(volume: AnyArray, grey: AnyArray, step: int, jump: int, neutral: int, contrast: float) -> AnyArray:
    height, width, depths = volume.shape
    total = np.zeros((height, width, depths), np.uint16)
    for row in numba.prange(height):
        for back in range(2):
            _path(volume[row], grey[row], total[row], back == 1, step, jump, neutral, contrast)
    for column in numba.prange(width):
        for back in range(2):
            _path(volume[:, column], grey[:, column], total[:, column], back == 1, step, jump, neutral, contrast)
    return total


@numba.njit(cache=True, nogil=True)
def _path(
    costs: AnyArray, grey: AnyArray, total: AnyArray, back: bool, step: int, jump: int, neutral: int, contrast: float
) -> None:
    """Add one path's costs (N, D) to the sum; it runs backwards if ``back``."""
    count, depths = costs.shape
    before = np.zeros(depths + 2, np.int32)
    now = np.zeros(depths + 2, np.int32)
    # Beyond the ends nothing is cheaper.
    before[0] = before[depths + 1] = now[0] = now[depths + 1] = 1 << 20
    least = 0
    for index in range(count):
        at = count - 1 - index if back else index
        behind = at + 1 if back else at - 1
        change = abs(grey[at] - grey[behind]) if index else 0.0
        leap = max(int(jump / (1.0 + change / contrast)), step + 1)
        ceiling = least + leap
        lowest = 1 << 20
        for depth in range(depths):
            own = np.int32(costs[at, depth])
            if own == UNKNOWN:
                own = np.int32(neutral)
            near = min(before[depth], before[depth + 2]) + step
            value = own + min(min(before[depth + 1], near), ceiling) - least
            now[depth + 1] = value
            lowest = min(lowest, value)
        for depth in range(depths):
            total[at, depth] += np.uint16(now[depth + 1])
        before, now = now, before
        least = lowest


@numba.njit(cache=True, parallel=True, nogil=True)
def decide(
    volume: AnyArray, total: AnyArray, valid: AnyArray, low: float, high: float, most_cost: float, margin: float
) -> tuple[Float32, Float32]:
    """Depth (H, W), NaN where unknown, and confidence (H, W) of a smoothed volume.

    The cheapest depth counts if what it costs by itself is at most ``most_cost``, and all depths that are not beside
    it cost at least ``margin`` of one path's jump more; it is refined by a parabola through its neighbours' sums.
    """
    height, width, depths = total.shape
    depth = np.full((height, width), np.nan, np.float32)
    confidence = np.zeros((height, width), np.float32)
    for row in numba.prange(height):
        for column in range(width):
            if not valid[row, column]:
                continue
            sums = total[row, column]
            best = 0
            for index in range(depths):
                if sums[index] < sums[best]:
                    best = index
            if best == 0 or best == depths - 1:
                # What lies beyond the range fits its ends best.
                continue
            own = int(volume[row, column, best])
            for index in range(best - 1, best + 2):
                own = min(own, int(volume[row, column, index]))
            second = 1 << 20
            for index in range(depths):
                if abs(index - best) > 2:
                    second = min(second, int(sums[index]))
            gap = second - int(sums[best])
            if own > most_cost or gap < margin:
                continue
            place = float(best)
            before, here, after = float(sums[best - 1]), float(sums[best]), float(sums[best + 1])
            curve = before - 2.0 * here + after
            if curve > 0.0:
                place += 0.5 * (before - after) / curve
            depth[row, column] = 1.0 / (low + place * (high - low) / (depths - 1))
            confidence[row, column] = (1.0 - own / 127.0) * min(gap / (4.0 * margin), 1.0)
    return depth, confidence
