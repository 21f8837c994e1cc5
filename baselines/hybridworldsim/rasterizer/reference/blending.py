"""Ellipses blended front to back into a picture."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from hybridworldsim.rasterizer.blended import Blended
from hybridworldsim.rasterizer.presets import ALPHA_MIN, TRANSMITTANCE_STOP, Preset
from hybridworldsim.rasterizer.projected import Projected
from hybridworldsim.rasterizer.reference.tiles import alphas, pairs


def blend(
    projected: Projected,
    features: Tensor,
    opacities: Tensor,
    width: int,
    height: int,
    *,
    preset: Preset,
    tile_size: int,
    absgrad: bool,
) -> Blended:
    """Blend in the order of (float32 depth, index), each pixel until it stops.

    Evaluates 256 Gaussians at all pixels of a tile at a time. Their intermediate values are not kept for the backward
    pass but computed again, so that memory stays that of the pairs.

    Args:
        projected: M Gaussians.
        features: (M, D) what is blended, a row for each of `projected`.
        opacities: (M,) with compensations already multiplied in.
        width: pixels.
        height: pixels.
        preset: whose cap of alpha.
        tile_size: pixels; a preset of square extents truncates Gaussians at the tiles that the square touches.
        absgrad: set `projected.means2d.absgrad` (M, 2) in backward: the sum over pixels of each pixel's absolute
            gradient.

    Returns:
        In float64, differentiable to projected.means2d, projected.conics, features and opacities.
    """
    rows, tiles = pairs(projected, width, height, tile_size)
    inputs = (
        (projected.means2d.double() + projected.means2d_low)[rows],
        projected.conics.double()[rows],
        opacities.double()[rows],
        features.double()[rows],
    )
    absolute = torch.zeros(len(rows), 2, dtype=torch.float64)  # one slot a pair
    if absgrad and inputs[0].requires_grad:
        _report_absgrad(inputs[0], projected.means2d, rows, absolute)

    # Taking rows once and splitting makes one gradient for all chunks, not one as large as the scene for each.
    chunks = [chunk for tile in tiles for chunk in tile.chunks()]
    sizes = [chunk.stop - chunk.start for chunk in chunks]
    parts = iter(zip(*(part.split(sizes) for part in inputs))) if sizes else iter(())

    images, opaque = [], []
    last = torch.full((height * width,), -1)
    processed = stopped = 0
    for tile in tiles:
        light = torch.ones(len(tile.pixels), dtype=torch.float64)
        going = torch.ones(len(tile.pixels), dtype=torch.bool)
        image = torch.zeros(len(tile.pixels), features.shape[1], dtype=torch.float64)
        for chunk in tile.chunks():
            inside = next(parts)
            if not going.any():
                continue
            # not as a tensor: backward writes to it while the checkpoint holds it
            gather = partial(_gather, absolute[chunk]) if absgrad else None
            added, light, going, hindmost = checkpoint(
                _chunk, *inside, tile.centres, light, going, preset.alpha_max, gather,
                use_reentrant=False, preserve_rng_state=False,
            )  # fmt: skip
            image = image + added
            hit = hindmost >= 0
            last[tile.pixels[hit]] = rows[chunk][hindmost[hit]]
            processed += chunk.stop - chunk.start
        images.append(image)
        opaque.append(1.0 - light)
        stopped += int(not going.any())

    # an empty picture, too, has a gradient: of zero, to every input
    means, conics, opacity, feature = (part[:0] for part in inputs)
    pixels = torch.cat([torch.empty(0, dtype=torch.int64), *(tile.pixels for tile in tiles)])
    image = torch.zeros(height * width, features.shape[1], dtype=torch.float64)
    image = image.index_copy(0, pixels, torch.cat([feature, *images]))
    alpha = torch.zeros(height * width, dtype=torch.float64)
    alpha = alpha.index_copy(0, pixels, torch.cat([opacity + means.sum(-1) + conics.sum(-1), *opaque]))
    return Blended(
        image=image.view(height, width, features.shape[1]),
        alpha=alpha.view(height, width),
        last=last.to(torch.int32).view(height, width),
        counts={"pairs": len(rows), "processed_pairs": processed, "stopped_tiles": stopped},
    )


def _chunk(
    means: Tensor,
    conics: Tensor,
    opacities: Tensor,
    features: Tensor,
    centres: Tensor,
    light: Tensor,
    going: Tensor,
    alpha_max: float,
    gather: Callable[[Tensor], None] | None,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Blend L Gaussians into the P pixels of a tile.

    Args:
        means: (L, 2).
        conics: (L, 3).
        opacities: (L,).
        features: (L, D).
        centres: (P, 2).
        light: (P,) transmittance in front of the first.
        going: (P,) whether a pixel has not stopped.
        alpha_max: cap of alpha.
        gather: takes the gradient (L, P, 2) of each Gaussian's mean at each pixel in backward.

    Returns:
        What is added (P, D), the light behind (P,), which pixels go on (P,), the hindmost that was blended (P,) or -1.
    """
    offsets = means[:, None] - centres  # (L, P, 2)
    if gather is not None and offsets.requires_grad:
        offsets.register_hook(gather)
    alpha = alphas(offsets, conics, opacities, alpha_max)  # (L, P)
    alpha = torch.where((alpha >= ALPHA_MIN) & going, alpha, 0.0)
    with torch.no_grad():  # a Gaussian behind which too little light is left is not blended, nor is any behind it
        kept = light * (1.0 - alpha).cumprod(0) > TRANSMITTANCE_STOP
        hindmost = torch.where(kept & (alpha > 0.0), torch.arange(len(alpha))[:, None], -1).amax(0)
    alpha = torch.where(kept, alpha, 0.0)
    behind = light * (1.0 - alpha).cumprod(0)  # (L, P)
    weights = alpha * torch.cat([light[None], behind[:-1]])
    return weights.T @ features, behind[-1], going & kept[-1], hindmost


def _gather(absolute: Tensor, gradient: Tensor) -> None:
    absolute += gradient.abs().sum(1)


def _report_absgrad(taken: Tensor, means2d: Tensor, rows: Tensor, absolute: Tensor) -> None:
    """When the gradient of the taken means is complete, sum the pairs' slots and empty them for another backward."""

    def report(gradient: Tensor) -> None:
        means2d.absgrad = torch.zeros_like(means2d).index_add(0, rows, absolute.to(means2d.dtype))  # type: ignore[attr-defined]
        absolute.zero_()

    taken.register_hook(report)
