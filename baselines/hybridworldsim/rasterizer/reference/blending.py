"""Ellipses blended front to back into a picture."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from hybridworldsim.rasterizer.blended_image import BlendedImage
from hybridworldsim.rasterizer.presets import ALPHA_MIN, TRANSMITTANCE_STOP, Preset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference.tiles import compute_alphas, pair_tiles, single_thread


def blend(
    projected: ProjectedGaussians,
    features: Tensor,
    opacities: Tensor,
    width: int,
    height: int,
    *,
    preset: Preset,
    tile_size: int,
    absgrad: bool,
) -> BlendedImage:
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
    rows, tiles = pair_tiles(projected, opacities, width, height, preset=preset, tile_size=tile_size)
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

    images, alpha_parts = [], []
    processed = stopped = 0
    for tile in tiles:
        transmittance = torch.ones(len(tile.pixels), dtype=torch.float64)
        active = torch.ones(len(tile.pixels), dtype=torch.bool)
        image = torch.zeros(len(tile.pixels), features.shape[1], dtype=torch.float64)
        for chunk in tile.chunks():
            inside = next(parts)
            if not active.any():
                continue
            call = partial(_blend_chunk, tile.centres, active, preset.alpha_max, absolute[chunk] if absgrad else None)
            added, transmittance, active = _Recompute.apply(call, *inside, transmittance)
            image = image + added
            processed += chunk.stop - chunk.start
        images.append(image)
        alpha_parts.append(1.0 - transmittance)
        stopped += int(not active.any())

    # an empty picture, too, has a gradient: of zero, to every input
    means, conics, opacity, feature = (part[:0] for part in inputs)
    pixels = torch.cat([torch.empty(0, dtype=torch.int64), *(tile.pixels for tile in tiles)])
    image = torch.zeros(height * width, features.shape[1], dtype=torch.float64)
    image = image.index_copy(0, pixels, torch.cat([feature, *images]))
    alpha = torch.zeros(height * width, dtype=torch.float64)
    alpha = alpha.index_copy(0, pixels, torch.cat([opacity + means.sum(-1) + conics.sum(-1), *alpha_parts]))
    return BlendedImage(
        image=image.view(height, width, features.shape[1]),
        alpha=alpha.view(height, width),
        counts={"pairs": len(rows), "processed_pairs": processed, "stopped_tiles": stopped},
    )


def _blend_chunk(
    centres: Tensor,
    active: Tensor,
    alpha_max: float,
    absolute: Tensor | None,
    means: Tensor,
    conics: Tensor,
    opacities: Tensor,
    features: Tensor,
    transmittance: Tensor,
) -> tuple[Tensor, ...]:
    """Blend L Gaussians into the P pixels of a tile.

    Args:
        centres: (P, 2).
        active: (P,) whether a pixel has not stopped.
        alpha_max: cap of alpha.
        absolute: (L, 2) gathers absolute gradients of the means in backward.
        means: (L, 2).
        conics: (L, 3).
        opacities: (L,).
        features: (L, D).
        transmittance: (P,) transmittance in front of the first.

    Returns:
        What is added (P, D), the light behind (P,), which pixels go on (P,).
    """
    x, y = offsets = [means[:, axis, None] - centres[:, axis] for axis in range(2)]  # (L, P) each
    if absolute is not None and x.requires_grad:
        for axis, offset in enumerate(offsets):
            offset.register_hook(partial(_add_absolute, absolute[:, axis]))
    alpha = compute_alphas(x, y, conics, opacities, alpha_max)  # (L, P)
    alpha = torch.where((alpha >= ALPHA_MIN) & active, alpha, 0.0)
    after = transmittance * (1.0 - alpha).cumprod(0)  # (L, P)
    # a Gaussian behind which too little light is left is not blended, nor is any behind it
    kept = after > TRANSMITTANCE_STOP
    weights = torch.where(kept, alpha * torch.cat([transmittance[None], after[:-1]]), 0.0)
    return weights.T @ features, transmittance - weights.sum(0), active & kept[-1]


def _add_absolute(slots: Tensor, gradient: Tensor) -> None:
    slots += gradient.abs().sum(1)


def _report_absgrad(taken: Tensor, means2d: Tensor, rows: Tensor, absolute: Tensor) -> None:
    """When the gradient of the taken means is complete, sum the pairs' slots and empty them for another backward."""

    def report(gradient: Tensor) -> None:
        means2d.absgrad = torch.zeros_like(means2d).index_add(0, rows, absolute.to(means2d.dtype))  # type: ignore[attr-defined]
        absolute.zero_()

    taken.register_hook(report)


class _Recompute(torch.autograd.Function):
    """A call that keeps its inputs alone, and calls again for the backward pass.

    What `torch.utils.checkpoint` does, whose import of the compiler takes seconds.
    """

    @staticmethod
    @single_thread()
    def forward(ctx: Any, call: Callable[..., tuple[Tensor, ...]], *tensors: Tensor) -> tuple[Tensor, ...]:
        ctx.call = call
        ctx.save_for_backward(*tensors)
        outputs = call(*tensors)
        ctx.mark_non_differentiable(*(output for output in outputs if not output.is_floating_point()))
        return outputs

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        tensors = [
            tensor.detach().requires_grad_(needed)
            for tensor, needed in zip(ctx.saved_tensors, ctx.needs_input_grad[1:])
        ]
        wanted = [tensor for tensor in tensors if tensor.requires_grad]
        with single_thread():
            with torch.enable_grad():
                outputs = ctx.call(*tensors)
            followed = [(output, gradient) for output, gradient in zip(outputs, gradients) if output.requires_grad]
            ends, starts = zip(*followed)
            found = iter(torch.autograd.grad(ends, wanted, starts, allow_unused=True))
        return (None, *(next(found) if tensor.requires_grad else None for tensor in tensors))
