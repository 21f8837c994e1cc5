"""Blends ellipses front to back to an image."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from hybridworldsim.rasterizer.blended_image import BlendedImage
from hybridworldsim.rasterizer.presets import ALPHA_MIN, TRANSMITTANCE_STOP, GsplatPreset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference.tiles import compute_alphas, pair_tiles, single_thread


def blend(
    projected: ProjectedGaussians,
    features: Tensor,
    opacities: Tensor,
    width: int,
    height: int,
    *,
    preset: GsplatPreset,
    tile_size: int,
    absgrad: bool,
) -> BlendedImage:
    """Blend in the order of (float32 depth, index); each pixel stops once almost no light passes.

    The function evaluates 256 Gaussians at all pixels of a tile at a time. The backward pass computes intermediate
    values again, so that memory is proportional to the number of pairs.

    Args:
        projected: M Gaussians.
        features: (M, D) features of `projected`.
        opacities: (M,) compensated opacities.
        width: width of the image, pixels.
        height: height of the image, pixels.
        preset: generation of gsplat, for the upper bound of alpha.
        tile_size: pixels; a preset with square extents truncates Gaussians at the tiles that the square touches.
        absgrad: whether backward sets `projected.means2d.absgrad` (M, 2), the sum of absolute gradients over pixels.

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
    absolute = torch.zeros(len(rows), 2, dtype=torch.float64)  # one row per pair
    if absgrad and inputs[0].requires_grad:
        _report_absgrad(inputs[0], projected.means2d, rows, absolute)

    # One index and one split make a single gradient; an index per chunk would make one of the scene's size per chunk.
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

    # an empty image also has a gradient to each input, of zero
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
        active: (P,) pixels that have not stopped.
        alpha_max: upper bound of alpha.
        absolute: (L, 2) receives absolute gradients of the means in backward.
        means: (L, 2).
        conics: (L, 3).
        opacities: (L,).
        features: (L, D).
        transmittance: (P,) transmittance in front of the first Gaussian.

    Returns:
        The added features (P, D), the transmittance behind the last Gaussian (P,), and the pixels that continue (P,).
    """
    x, y = offsets = [means[:, axis, None] - centres[:, axis] for axis in range(2)]  # (L, P) each
    if absolute is not None and x.requires_grad:
        for axis, offset in enumerate(offsets):
            offset.register_hook(partial(_add_absolute, absolute[:, axis]))
    alpha = compute_alphas(x, y, conics, opacities, alpha_max)  # (L, P)
    alpha = torch.where((alpha >= ALPHA_MIN) & active, alpha, 0.0)
    after = transmittance * (1.0 - alpha).cumprod(0)  # (L, P)
    # a Gaussian that would leave too little transmittance is not blended, and neither are those behind it
    kept = after > TRANSMITTANCE_STOP
    weights = torch.where(kept, alpha * torch.cat([transmittance[None], after[:-1]]), 0.0)
    return weights.T @ features, transmittance - weights.sum(0), active & kept[-1]


def _add_absolute(rows: Tensor, gradient: Tensor) -> None:
    """Add the absolute gradients of all pixels (L, P) to rows (L,)."""
    rows += gradient.abs().sum(1)


def _report_absgrad(taken: Tensor, means2d: Tensor, rows: Tensor, absolute: Tensor) -> None:
    """Sum the pairs' rows once the gradient of the taken means is complete, and reset them for the next backward."""

    def report(gradient: Tensor) -> None:
        means2d.absgrad = torch.zeros_like(means2d).index_add(0, rows, absolute.to(means2d.dtype))  # type: ignore[attr-defined]
        absolute.zero_()

    taken.register_hook(report)


class _Recompute(torch.autograd.Function):
    """Keeps only the inputs of a call, and repeats the call in the backward pass.

    `torch.utils.checkpoint` does the same, but its import takes seconds because it imports the compiler.
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
        inputs_with_gradient = [tensor for tensor in tensors if tensor.requires_grad]
        with single_thread():
            with torch.enable_grad():
                outputs = ctx.call(*tensors)
            used = [(output, gradient) for output, gradient in zip(outputs, gradients) if output.requires_grad]
            ends, starts = zip(*used)
            input_gradients = iter(torch.autograd.grad(ends, inputs_with_gradient, starts, allow_unused=True))
        return (None, *(next(input_gradients) if tensor.requires_grad else None for tensor in tensors))
