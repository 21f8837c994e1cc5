"""What Gaussians before a depth cover of each pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.rasterizer.presets import ALPHA_MIN, DEFAULT_PRESET, TRANSMITTANCE_STOP, get_preset
from mirror.arrays import Float32, Int32, Int64

_NUMBERS: Final = ("means2d", "conics", "depths", "opacities")
_ROUNDING: Final = 1e-6
_CHUNK: Final = 1 << 22
"""Pairs of Gaussian and pixel that plain torch computes at a time."""


def covered_before(meta: Mapping[str, Any], limit_m: Float32) -> Tensor:
    """Compute the share of each pixel that the Gaussians of an image nearer than a depth cover.

    It is the alpha of an image of the Gaussians with a nearer centre, if that image blended the Gaussian that ends a
    pixel too (`TRANSMITTANCE_STOP`). The light that comes through Gaussians is the product of what each lets through:
    no order is needed, and only those before a limit are visited.

    Args:
        meta: what `rasterization` returned for one image, with packed tensors, as gsplat names them.
        limit_m: (H, W) depth (camera z) of each pixel; 0 or less: nothing is before it.

    Returns:
        (H, W) shares, 0 to 1, on the device of the Gaussians: a compiled kernel on the CPU, elsewhere plain torch.
    """
    if not is_compiled(meta["means2d"]):
        return _cover_plainly(meta, limit_m)
    means2d, conics, depths, opacities = (
        np.ascontiguousarray(meta[name].detach().cpu().numpy(), np.float32) for name in _NUMBERS
    )
    limit = np.ascontiguousarray(limit_m, np.float32)
    wanted = limit > 0.0
    through = np.ones(limit.shape, np.float32)
    if wanted.any():
        columns = np.stack([wanted.argmax(axis=1), limit.shape[1] - wanted[:, ::-1].argmax(axis=1)], axis=1)
        columns[~wanted.any(axis=1)] = 0
        preset = get_preset(DEFAULT_PRESET)
        let_through(
            means2d, conics, depths, opacities, preset.alpha_max, limit, limit.max(axis=1), columns.astype(np.int32),
            through,
        )  # fmt: skip
    return torch.from_numpy(1.0 - through)


def _cover_plainly(meta: Mapping[str, Any], limit_m: Float32) -> Tensor:
    """Compute `covered_before` in plain torch: of each Gaussian the pixels of its bounds, among those with a limit."""
    rows, columns = (np.flatnonzero((limit_m > 0.0).any(axis=axis)) for axis in (1, 0))
    means2d, conics, depths, opacities = (meta[name].detach().float() for name in _NUMBERS)
    limit = torch.from_numpy(np.ascontiguousarray(limit_m, np.float32)).to(means2d.device)
    through = torch.zeros(limit.numel(), device=limit.device)
    if not len(rows):
        return through.view_as(limit)
    a, b, c = conics.unbind(1)
    level = 2.0 * (opacities / ALPHA_MIN).log()
    spread = a.double() * c * (1.0 - _ROUNDING) - b.double() * b
    bounds = [
        _bound_pixels(middle, torch.where(spread > 0.0, (level * side / spread).sqrt(), torch.inf), inside)
        for middle, side, inside in zip(means2d.unbind(1), (c, a), (columns, rows), strict=True)
    ]
    (left, wide), (top, high) = bounds
    reached = (wide > 0) & (high > 0) & (depths < limit.max()) & (opacities > ALPHA_MIN)
    chosen = reached.nonzero().squeeze(1)
    counts = wide[chosen] * high[chosen]
    ends = counts.cumsum(0).cpu()
    alpha_max, begin = get_preset(DEFAULT_PRESET).alpha_max, 0
    while begin < len(chosen):
        before = int(ends[begin - 1]) if begin else 0
        end = max(int(torch.searchsorted(ends, before + _CHUNK)), begin + 1)
        own = chosen[begin:end].repeat_interleave(counts[begin:end])
        first = (counts[begin:end].cumsum(0) - counts[begin:end]).repeat_interleave(counts[begin:end])
        number = torch.arange(len(own), device=own.device) - first
        row, column = top[own] + number // wide[own], left[own] + number % wide[own]
        pixel = row * limit.shape[1] + column
        dx, dy = column + 0.5 - means2d[own, 0], row + 0.5 - means2d[own, 1]
        power = -0.5 * (a[own] * dx * dx + c[own] * dy * dy) - b[own] * dx * dy
        alpha = (opacities[own] * power.exp()).clamp_max(alpha_max)
        lets = (alpha >= ALPHA_MIN) & (depths[own] < limit.view(-1)[pixel])
        through.index_add_(0, pixel, torch.where(lets, torch.log1p(-alpha), 0.0))
        begin = end
    return (1.0 - through.exp()).view_as(limit)


def _bound_pixels(middle: Tensor, reach: Tensor, inside: Int64) -> tuple[Tensor, Tensor]:
    """Return the first pixel (M,) within a reach of places, and how many there are, among those from first to last."""
    first, last = int(inside[0]), int(inside[-1])
    low = (middle - reach - 0.5).ceil().clamp(first, last + 1)
    high = (middle + reach - 0.5).floor().clamp(first - 1, last)
    return low.long(), (high - low + 1.0).long().clamp_min(0)


@kernel()
def let_through(
    means2d: Float32,
    conics: Float32,
    depths: Float32,
    opacities: Float32,
    alpha_max: float,
    limit_m: Float32,
    row_limit_m: Float32,
    columns: Int32,
    through: Float32,
) -> None:
    """Multiply the light of each pixel by the transmittance of the Gaussians nearer than the pixel's limit.

    Args:
        means2d: (M, 2) pixels.
        conics: (M, 3) inverses of the covariances, pixels^-2.
        depths: (M,) camera z, metres.
        opacities: (M,).
        alpha_max: upper bound of alpha.
        limit_m: (H, W) limits.
        row_limit_m: (H,) greatest limit of each row.
        columns: (H, 2) first column with a limit of each row, and one past the last; both are 0 where there is none.
        through: (H, W) light of each pixel; updated.
    """
    height, width = limit_m.shape
    least, stop = np.float32(ALPHA_MIN), np.float32(TRANSMITTANCE_STOP)
    top, bottom, farthest = height, 0, np.float32(0.0)
    for row in range(height):
        if columns[row, 1] > 0:
            top, bottom = min(top, row), row + 1
            farthest = max(farthest, row_limit_m[row])
    for number in range(len(depths)):
        depth, opacity = depths[number], opacities[number]
        if not depth < farthest or not opacity > least:
            continue
        a, b, c = conics[number, 0], conics[number, 1], conics[number, 2]
        x, y = means2d[number, 0], means2d[number, 1]
        # Where alpha is at least its minimum: an ellipse of this level, whose bounds follow from the covariance.
        level = np.float32(2.0) * math.log(opacity / least)
        # Numbers are rounded: without the last term the bounds of a very long ellipse may be too narrow.
        spread = float(a) * float(c) * (1.0 - _ROUNDING) - float(b) * float(b)
        reach = np.float32(math.sqrt(level * a / spread)) if spread > 0.0 else np.float32(np.inf)
        first = max(math.ceil(max(y - reach, np.float32(-1.0)) - 0.5), top)
        last = min(math.floor(min(y + reach, np.float32(height + 1)) - 0.5), bottom - 1)
        for row in range(first, last + 1):
            if not depth < row_limit_m[row]:
                continue
            dy = np.float32(row) + np.float32(0.5) - y
            # On a row the ellipse ends where a dx^2 + 2 b dx dy + c dy^2 = level.
            middle = -b * dy / a
            square = middle * middle - (c * dy * dy - level) / a
            if not square >= 0.0:
                continue
            half = math.sqrt(square)
            left = max(math.ceil(max(x + middle - half, np.float32(-1.0)) - 0.5), columns[row, 0])
            right = min(math.floor(min(x + middle + half, np.float32(width + 1)) - 0.5), columns[row, 1] - 1)
            for column in range(left, right + 1):
                light = through[row, column]
                if depth < limit_m[row, column] and light > stop:
                    dx = np.float32(column) + np.float32(0.5) - x
                    power = np.float32(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy
                    alpha = min(opacity * math.exp(power), np.float32(alpha_max))
                    through[row, column] = light * (np.float32(1.0) - alpha)
