"""Finds pixels at which rounding may decide whether a Gaussian is blended, and bounds the effect."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from hybridworldsim.rasterizer.presets import ALPHA_MIN, TRANSMITTANCE_STOP, GsplatPreset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference.tiles import compute_alphas, pair_tiles, single_thread

ALPHA_TOLERANCE = 1e-4
"""Relative distance from `ALPHA_MIN` within which float32 and float64 may decide differently."""

STOP_TOLERANCE = 1e-3
"""Relative distance from `TRANSMITTANCE_STOP` within which float32 and float64 may decide differently."""


class RoundingMarks(NamedTuple):
    """Pixels at which a float32 kernel may differ from the reference by more than rounding.

    Attributes:
        marked: (H, W) bool.
        jump: (H, W) upper bound of the change that flipped decisions can make to alpha, or to a feature in [0, 1]; 0
            where not marked. For a feature in [low, high] the bound is max(high, 0) - min(low, 0) times as large.
    """

    marked: Tensor
    jump: Tensor


@torch.no_grad()
@single_thread()
def find_rounding_marks(
    projected: ProjectedGaussians, opacities: Tensor, width: int, height: int, *, preset: GsplatPreset, tile_size: int
) -> RoundingMarks:
    """Blend in float64 and mark the pixels at which a value lies near a threshold.

    If a Gaussian flips at the cut of alpha, the image changes by its weight at most, and the transmittance behind it by
    1/255, which widens the neighbourhood of the stop. If a Gaussian flips at the stop, the image changes by the
    transmittance in front of it at most.

    Args:
        projected: M Gaussians from the reference.
        opacities: (M,) compensated opacities.
        width: width of the image, pixels.
        height: height of the image, pixels.
        preset: generation of gsplat, for the upper bound of alpha.
        tile_size: side of a tile, pixels.
    """
    rows, tiles = pair_tiles(projected, opacities, width, height, preset=preset, tile_size=tile_size)
    means, conics = projected.means2d.double() + projected.means2d_low, projected.conics.double()
    opacities = opacities.double()
    marked = torch.zeros(height * width, dtype=torch.bool)
    jump = torch.zeros(height * width, dtype=torch.float64)
    for tile in tiles:
        transmittance = torch.ones(len(tile.pixels), dtype=torch.float64)  # in front of the chunk
        widening = torch.zeros_like(transmittance)  # relative change of the transmittance by flips so far
        active = torch.ones(len(tile.pixels), dtype=torch.bool)
        for chunk in tile.chunks():
            if not active.any():
                break
            ids = rows[chunk]
            x, y = (means[ids, axis, None] - tile.centres[:, axis] for axis in range(2))
            alpha = compute_alphas(x, y, conics[ids], opacities[ids], preset.alpha_max)  # (L, P)
            at_cut = (alpha / ALPHA_MIN - 1.0).abs() <= ALPHA_TOLERANCE
            alpha = torch.where(alpha >= ALPHA_MIN, alpha, 0.0)
            after = transmittance * (1.0 - alpha).cumprod(0)
            before = torch.cat([transmittance[None], after[:-1]])
            tolerance = widening + (at_cut * (ALPHA_MIN / (1.0 - 2.0 * ALPHA_MIN))).cumsum(0)
            at_stop = (after / TRANSMITTANCE_STOP - 1.0).abs() <= STOP_TOLERANCE + tolerance
            at_stop &= (alpha > 0.0) | at_cut

            # a pixel continues until the first Gaussian that stops it or may stop it; in the second case the
            # transmittance in front of that Gaussian bounds the contribution of all Gaussians behind
            continues = (after > TRANSMITTANCE_STOP) & ~at_stop
            continues = active & continues.cummin(0).values
            ends = ~continues & torch.cat([active[None], continues[:-1]])
            at_cut &= continues
            at_stop &= ends
            jump[tile.pixels] += (before * (at_stop + at_cut * (1.0 + tolerance) * ALPHA_MIN)).sum(0)
            marked[tile.pixels] |= (at_cut | at_stop).any(0)
            transmittance, widening, active = after[-1], tolerance[-1], continues[-1]
    return RoundingMarks(marked.view(height, width), jump.view(height, width))
