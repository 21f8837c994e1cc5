"""Plane-sweep stereo in plain torch, on any device; `hybridworldsim.mvs.sweep` has the compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.mvs.sweep.correlation import COSTS, RADIUS, UNKNOWN

_SIDE: Final = 2 * RADIUS + 1
_SLACK_PX: Final = 1e-3
_NONE: Final = -2.0
_TOO_EXPENSIVE: Final = 1 << 14
_NEVER: Final = 1 << 20
_CHUNK: Final = 1 << 23
"""Warped pixels that are computed at a time: about ten numbers of four bytes each."""


def compute_cost_volume(
    reference: Tensor,
    sources: Sequence[Tensor],
    homographies: Tensor,
    inverse_depth: Tensor,
    inverse_range: tuple[float, float],
    bins: int,
    *,
    best: int,
    deviation: float,
) -> Tensor:
    """Compute the costs (H, W, bins), uint8, of all depths; see `hybridworldsim.mvs.sweep.correlation`.

    Args:
        reference: (H, W) grey; NaN where it does not count.
        sources: S images (H', W') of the same kind.
        homographies: (S, P, 3, 3) float64.
        inverse_depth: (P, 3) float64.
        inverse_range: smallest and largest inverse depth, 1 / m.
        bins: number of depths.
        best: number of best sources that count.
        deviation: least standard deviation of a window.
    """
    height, width = reference.shape
    volume = torch.full((height, width, bins), int(UNKNOWN), dtype=torch.uint8, device=reference.device)
    if min(height, width) < _SIDE:
        return volume
    stack = _stack_padded(sources)
    mean, scale = _compute_statistics(reference, deviation)
    planes = inverse_depth.shape[0]
    step = max(1, _CHUNK // (len(sources) * height * width))
    for first in range(0, planes, step):
        chosen = slice(first, min(first + step, planes))
        warped = torch.stack([_warp(source, h[chosen], height, width) for source, h in zip(stack, homographies)])
        scores = _correlate(reference, warped, mean, scale, deviation)
        _enter_costs(volume, scores.topk(best, dim=0).values, inverse_depth[chosen], inverse_range)
    return volume


def smooth_costs(volume: Tensor, grey: Tensor, *, step: int, jump: int, neutral: int, contrast: float) -> Tensor:
    """Sum the costs (H, W, D), int16, over four paths; see `hybridworldsim.mvs.sweep.path_costs.smooth_costs`."""
    costs = torch.where(volume == int(UNKNOWN), neutral, volume.to(torch.int16))
    total = torch.zeros_like(costs)
    known = torch.nan_to_num(grey, nan=9.0)
    for axis in (1, 0):
        # A view, so that the sums are added in place.
        _add_paths(costs.movedim(axis, 0), known.movedim(axis, 0), total.movedim(axis, 0), step, jump, contrast)
    return total


def select_depths(
    volume: Tensor, total: Tensor, valid: Tensor, low: float, high: float, max_cost: float, margin: float
) -> tuple[Tensor, Tensor]:
    """Select depth and confidence (H, W) of each pixel; see `hybridworldsim.mvs.sweep.path_costs.select_depths`."""
    depths = total.shape[2]
    sums = total.to(torch.int32)
    best = sums.argmin(2, keepdim=True)
    inner = best.clamp(1, max(depths - 2, 1))
    around = (inner + torch.arange(-1, 2, device=total.device)).clamp_max(depths - 1)
    cost = volume.gather(2, around).amin(2).to(torch.float64)
    apart = (torch.arange(depths, device=total.device) - best).abs() > 2
    second = torch.where(apart, sums, _NEVER).amin(2)
    before, here, after = sums.gather(2, around).to(torch.float64).unbind(2)
    gap = (second - sums.gather(2, best)[..., 0]).to(torch.float64)
    curve = before - 2.0 * here + after
    shift = torch.where(curve > 0.0, 0.5 * (before - after) / curve.clamp_min(1.0), 0.0)
    position = best[..., 0].to(torch.float64) + shift
    depth = 1.0 / (low + position * ((high - low) / max(depths - 1, 1)))
    # A surface outside the range fits one of the ends of the range best.
    inside = (best[..., 0] > 0) & (best[..., 0] < depths - 1)
    known = valid & inside & (cost <= max_cost) & (gap >= margin)
    confidence = (1.0 - cost / 127.0) * (gap / (4.0 * margin)).clamp_max(1.0)
    return torch.where(known, depth, torch.nan).float(), torch.where(known, confidence, 0.0).float()


def _stack_padded(sources: Sequence[Tensor]) -> Tensor:
    """Stack images to (S, H', W') of the largest sides, at least two pixels, with NaN outside of each image."""
    height = max(2, *(source.shape[0] for source in sources))
    width = max(2, *(source.shape[1] for source in sources))
    return torch.stack(
        [
            functional.pad(source, (0, width - source.shape[1], 0, height - source.shape[0]), value=torch.nan)
            for source in sources
        ]
    )


def _sum_windows(image: Tensor) -> Tensor:
    """Sum the windows (..., H - 4, W - 4) of images (..., H, W); one that contains a NaN is NaN."""
    rows, columns = image.shape[-2] - _SIDE + 1, image.shape[-1] - _SIDE + 1
    # Not running sums or convolutions: these carry a NaN, and rounding, into other windows.
    down = image[..., :rows, :].clone()
    for tap in range(1, _SIDE):
        down += image[..., tap : tap + rows, :]
    total = down[..., :columns].clone()
    for tap in range(1, _SIDE):
        total += down[..., tap : tap + columns]
    return total


def _compute_statistics(grey: Tensor, deviation: float) -> tuple[Tensor, Tensor]:
    """Compute mean and inverse standard deviation (H - 4, W - 4) of windows; NaN without texture."""
    precise = grey.double()
    mean = _sum_windows(precise) / _SIDE**2
    variance = _sum_windows(precise * precise) / _SIDE**2 - mean * mean
    scale = torch.where(variance > deviation * deviation, variance.clamp_min(1e-300).rsqrt(), torch.nan)
    return mean.float(), scale.float()


def _warp(source: Tensor, homographies: Tensor, height: int, width: int) -> Tensor:
    """Warp a source by homographies (P, 3, 3) to the reference's pixels: (P, H, W), NaN outside."""
    device = source.device
    v = torch.arange(height, dtype=torch.float64, device=device) + 0.5
    # The first column of a row in double precision, steps from it in single precision.
    origin = 0.5 * homographies[:, :, 0, None] + homographies[:, :, 1, None] * v + homographies[:, :, 2, None]
    steps = torch.arange(width, dtype=torch.float32, device=device)
    x, y, z = (origin.float()[..., None] + homographies.float()[:, :, 0, None, None] * steps).unbind(1)
    scale = torch.where(z > 1e-9, z, torch.nan).reciprocal_()
    s, t = x.mul_(scale).sub_(0.5), y.mul_(scale).sub_(0.5)
    right, bottom = source.shape[1] - 1.0, source.shape[0] - 1.0
    # NaN compares false.
    inside = (s >= -_SLACK_PX) & (t >= -_SLACK_PX) & (s <= right + _SLACK_PX) & (t <= bottom + _SLACK_PX)
    s, t = torch.where(inside, s, 0.0).clamp_(0.0, right), torch.where(inside, t, 0.0).clamp_(0.0, bottom)
    left, top = s.long().clamp_max_(source.shape[1] - 2), t.long().clamp_max_(source.shape[0] - 2)
    a, b = s - left, t - top
    corner, flat = top * source.shape[1] + left, source.reshape(-1)
    above, below = (torch.lerp(flat[corner + shift], flat[corner + shift + 1], a) for shift in (0, source.shape[1]))
    return torch.where(inside, torch.lerp(above, below, b), torch.nan)


def _correlate(reference: Tensor, warped: Tensor, mean: Tensor, scale: Tensor, deviation: float) -> Tensor:
    """Correlate windows of warped images (S, P, H, W) with the reference: (S, P, H - 4, W - 4); `_NONE` without."""
    share = 1.0 / _SIDE**2
    other = _sum_windows(warped) * share
    variance = _sum_windows(warped * warped) * share - other * other
    product = _sum_windows(warped * reference) * share
    is_textured = variance > deviation * deviation
    correlation = (product - mean * other) * scale * torch.where(is_textured, variance, 1.0).rsqrt()
    return torch.where(is_textured & ~correlation.isnan(), correlation, _NONE)


def _enter_costs(volume: Tensor, best: Tensor, planes: Tensor, inverse_range: tuple[float, float]) -> None:
    """Lower the volume to the costs of the mean best scores (B, P, H - 4, W - 4) at the planes' depths."""
    low, high = inverse_range
    inner = volume[RADIUS:-RADIUS, RADIUS:-RADIUS]
    rows, columns, bins = inner.shape
    u = torch.arange(columns, dtype=torch.float64, device=volume.device) + (RADIUS + 0.5)
    v = torch.arange(rows, dtype=torch.float64, device=volume.device) + (RADIUS + 0.5)
    is_scored = best > _NONE
    score = torch.where(is_scored, best, 0.0).sum(0) / is_scored.sum(0).clamp_min(1)
    costs = ((1.0 - score.clamp(-1.0, 1.0)) * (0.5 * COSTS) + 0.5).to(torch.uint8)
    for cost, known, (a, b, c) in zip(costs, is_scored[0], planes):
        position = (a * u + b * v[:, None] + c - low) * ((bins - 1) / (high - low))
        enters = known & (position >= -0.5) & (position < bins - 0.5)
        index = (position.clamp(0.0, bins - 1.0) + 0.5).long().clamp_max_(bins - 1)[..., None]
        before = inner.gather(2, index)
        lower = torch.minimum(before, torch.where(enters, cost, int(UNKNOWN)).to(torch.uint8)[..., None])
        inner.scatter_(2, index, lower)


def _add_paths(costs: Tensor, grey: Tensor, total: Tensor, step: int, jump: int, contrast: float) -> None:
    """Add the costs of paths along the first axis of (N, L, D), in both directions at the same time."""
    change = (grey[1:] - grey[:-1]).abs().double()
    leap = (jump / (1.0 + change / contrast)).to(torch.int16).clamp_min_(step + 1)
    leaps, values = _pair(leap)[..., None], _pair(costs)
    # The padding at both ends is too expensive to be chosen.
    padded = functional.pad(values[0], (1, 1), value=_TOO_EXPENSIVE)
    here, below, above = padded[..., 1:-1], padded[..., :-2], padded[..., 2:]
    for value, leap in zip(values[1:], leaps):
        least = here.amin(2, keepdim=True)
        beside = torch.minimum(below, above).add_(step)
        cheapest = torch.minimum(torch.minimum(here, beside), least + leap).sub_(least)
        here.copy_(value.add_(cheapest))
    total += values[:, 0] + values[:, 1].flip(0)


def _pair(lines: Tensor) -> Tensor:
    """Return lines (N, ...) beside the same lines from the last to the first: (N, 2, ...)."""
    return torch.stack((lines, lines.flip(0)), 1)
