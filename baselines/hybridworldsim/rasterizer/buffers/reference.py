"""Tracing in float64, to be read."""

from __future__ import annotations

import torch
from torch import Tensor

from hybridworldsim.rasterizer.buffers.traced import Traced
from hybridworldsim.rasterizer.presets import ALPHA_MIN, TRANSMITTANCE_STOP, Preset
from hybridworldsim.rasterizer.projected import Projected
from hybridworldsim.rasterizer.reference.tiles import alphas, pairs


def trace(
    projected: Projected, opacities: Tensor, width: int, height: int, *, preset: Preset, tile_size: int, top: int
) -> Traced:
    """What each pixel shows.

    Args:
        projected: M Gaussians.
        opacities: (M,) as blended.
        width: pixels.
        height: pixels.
        preset: whose cap of alpha.
        tile_size: pixels.
        top: how many Gaussians of greatest weight.
    """
    rows, tiles = pairs(projected, opacities, width, height, preset=preset, tile_size=tile_size)
    means, conics = projected.means2d.double() + projected.means2d_low, projected.conics.double()
    best = torch.full((height * width, top), -1)
    weights = torch.zeros(height * width, top, dtype=torch.float64)
    number = torch.zeros(height * width, dtype=torch.int32)
    median = torch.full((height * width,), -1)
    for tile in tiles:
        light = torch.ones(len(tile.pixels), dtype=torch.float64)
        going = torch.ones(len(tile.pixels), dtype=torch.bool)
        for chunk in tile.chunks():
            ids = rows[chunk]  # (L,)
            x, y = (means[ids, axis, None] - tile.centres[:, axis] for axis in range(2))
            alpha = alphas(x, y, conics[ids], opacities[ids].double(), preset.alpha_max)  # (L, P)
            alpha = torch.where((alpha >= ALPHA_MIN) & going, alpha, 0.0)
            kept = light * (1.0 - alpha).cumprod(0) > TRANSMITTANCE_STOP
            alpha = torch.where(kept, alpha, 0.0)
            behind = light * (1.0 - alpha).cumprod(0)
            before = torch.cat([light[None], behind[:-1]])

            pixels = tile.pixels
            number[pixels] += (alpha > 0.0).sum(0, dtype=torch.int32)
            crosses = (before > 0.5) & (behind <= 0.5)
            median[pixels] = torch.where(crosses.any(0), ids[crosses.byte().argmax(0)], median[pixels])
            weighed = torch.cat([weights[pixels].T, alpha * before])  # (top + L, P)
            named = torch.cat([best[pixels].T, ids[:, None].expand_as(alpha)])
            greatest = weighed.argsort(dim=0, descending=True, stable=True)[:top]
            weights[pixels] = weighed.gather(0, greatest).T
            best[pixels] = named.gather(0, greatest).T
            light, going = behind[-1], going & kept[-1]
    return Traced(
        rows=torch.where(weights > 0.0, best, -1).view(height, width, top),
        weights=weights.view(height, width, top),
        n_contrib=number.view(height, width),
        median=median.view(height, width),
    )
