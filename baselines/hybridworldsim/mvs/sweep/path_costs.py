"""Smooths a cost volume along paths: a difference in depth between neighbouring pixels has a cost.

Hirschmueller, "Stereo processing by semiglobal matching and mutual information" (TPAMI 2008), with four paths.
"""

from __future__ import annotations

from functools import partial

import numba
import numpy as np

from hybridworldsim.kernels.threads import in_row_spans
from hybridworldsim.mvs.sweep.correlation import UNKNOWN
from mirror.arrays import AnyArray, Float32, UInt8
from mirror.compiled import inner_njit


def smooth_costs(volume: UInt8, grey: Float32, *, step: int, jump: int, neutral: int, contrast: float) -> AnyArray:
    """Sum the costs over the four paths through each pixel.

    Args:
        volume: (H, W, D) costs; `UNKNOWN` where no source sees the depth.
        grey: (H, W) the image; a jump costs less where the grey value changes. NaN counts as a large change.
        step: cost of a change of depth by one.
        jump: greatest cost of a larger change.
        neutral: cost that stands for an unknown cost.
        contrast: change of grey at which a jump costs half.

    Returns:
        (H, W, D) uint16.
    """
    total = np.zeros(volume.shape, np.uint16)
    # `unknown` is an argument, because a cached kernel keeps imported constants.
    settings = (step, jump, neutral, int(UNKNOWN), contrast)
    known = np.nan_to_num(grey, nan=9.0)
    in_row_spans(partial(_add_paths, volume, known, total, *settings), len(volume))
    columns = np.swapaxes(volume, 0, 1)
    in_row_spans(partial(_add_paths, columns, known.T, np.swapaxes(total, 0, 1), *settings), len(columns))
    return total


@numba.njit(cache=True, nogil=True)
def _add_paths(
    volume: AnyArray,
    grey: AnyArray,
    total: AnyArray,
    step: int,
    jump: int,
    neutral: int,
    unknown: int,
    contrast: float,
    begin: int,
    end: int,
) -> None:
    """Add the costs of the paths along some lines, in both directions."""
    for line in range(begin, end):
        for back in range(2):
            _add_path(volume[line], grey[line], total[line], back == 1, step, jump, neutral, unknown, contrast)


@inner_njit
def _add_path(
    costs: AnyArray,
    grey: AnyArray,
    total: AnyArray,
    back: bool,
    step: int,
    jump: int,
    neutral: int,
    unknown: int,
    contrast: float,
) -> None:
    """Add the costs (N, D) of one path to the sum; the path runs backwards if ``back``."""
    count, depths = costs.shape
    before = np.zeros(depths + 2, np.int32)
    now = np.zeros(depths + 2, np.int32)
    # The padding at both ends is too expensive to be chosen.
    before[0] = before[depths + 1] = now[0] = now[depths + 1] = 1 << 20
    least = 0
    for index in range(count):
        at = count - 1 - index if back else index
        previous = at + 1 if back else at - 1
        change = abs(grey[at] - grey[previous]) if index else 0.0
        leap = max(int(jump / (1.0 + change / contrast)), step + 1)
        ceiling = least + leap
        lowest = 1 << 20
        for depth in range(depths):
            cost = np.int32(costs[at, depth])
            if cost == unknown:
                cost = np.int32(neutral)
            beside = min(before[depth], before[depth + 2]) + step
            value = cost + min(min(before[depth + 1], beside), ceiling) - least
            now[depth + 1] = value
            lowest = min(lowest, value)
        for depth in range(depths):
            total[at, depth] += np.uint16(now[depth + 1])
        before, now = now, before
        least = lowest


def select_depths(
    volume: AnyArray, total: AnyArray, valid: AnyArray, low: float, high: float, max_cost: float, margin: float
) -> tuple[Float32, Float32]:
    """Select the cheapest depth of each pixel.

    The cheapest depth counts if its own cost is at most ``max_cost``, and if all depths that are more than two steps
    away cost at least ``margin`` more in the sum. A parabola through the sums of its neighbours refines it.

    Args:
        volume: (H, W, D) costs.
        total: (H, W, D) costs summed over the paths.
        valid: (H, W) pixels that get a depth.
        low: smallest inverse depth, 1 / m.
        high: largest inverse depth, 1 / m.
        max_cost: greatest cost in `volume`.
        margin: least difference in `total`.

    Returns:
        Depth (H, W), metres, NaN where unknown; confidence (H, W) from 0 to 1.
    """
    depth = np.full(valid.shape, np.nan, np.float32)
    confidence = np.zeros(valid.shape, np.float32)
    arrays = (volume, total, valid, low, high, max_cost, margin, depth, confidence)
    in_row_spans(partial(_select_depths, *arrays), len(valid))
    return depth, confidence


@numba.njit(cache=True, nogil=True)
def _select_depths(
    volume: AnyArray,
    total: AnyArray,
    valid: AnyArray,
    low: float,
    high: float,
    max_cost: float,
    margin: float,
    depth: AnyArray,
    confidence: AnyArray,
    begin: int,
    end: int,
) -> None:
    _, width, depths = total.shape
    for row in range(begin, end):
        for column in range(width):
            if not valid[row, column]:
                continue
            sums = total[row, column]
            best = 0
            for index in range(depths):
                if sums[index] < sums[best]:
                    best = index
            if best == 0 or best == depths - 1:
                # A surface outside the range fits one of the ends of the range best.
                continue
            cost = int(volume[row, column, best])
            for index in range(best - 1, best + 2):
                cost = min(cost, int(volume[row, column, index]))
            second = 1 << 20
            for index in range(depths):
                if abs(index - best) > 2:
                    second = min(second, int(sums[index]))
            gap = second - int(sums[best])
            if cost > max_cost or gap < margin:
                continue
            position = float(best)
            before, here, after = float(sums[best - 1]), float(sums[best]), float(sums[best + 1])
            curve = before - 2.0 * here + after
            if curve > 0.0:
                position += 0.5 * (before - after) / curve
            depth[row, column] = 1.0 / (low + position * (high - low) / (depths - 1))
            confidence[row, column] = (1.0 - cost / 127.0) * min(gap / (4.0 * margin), 1.0)
