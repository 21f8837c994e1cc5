"""Blends ellipses to an image, with gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.memory import empty_aligned, full_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from hybridworldsim.rasterizer.blended_image import BlendedImage
from hybridworldsim.rasterizer.cpu.blending.backward import SUMS, blend_tiles_backward, reduce_lines
from hybridworldsim.rasterizer.cpu.blending.canvas import BLOCKS, LANES, TILE_PX, Canvas, make_canvas
from hybridworldsim.rasterizer.cpu.blending.forward import BATCH, PLACEMENT_SIZE, blend_tiles
from hybridworldsim.rasterizer.cpu.blending.sorting import depth_order
from hybridworldsim.rasterizer.cpu.blending.splats import Splats, pack_splats
from hybridworldsim.rasterizer.cpu.blending.tiles import Tiles, assign_tiles
from hybridworldsim.rasterizer.presets import GsplatPreset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from mirror.arrays import Float32, Float64, Int32, Int64
from mirror.errors import UsageError

LEAST_SLICE: Final = 32768
"""Least number of Gaussians in the nearest slice."""

_SHARE: Final = 8
"""The nearest slice has at least one part in this number of all Gaussians."""


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
    """Blend ellipses front to back, by depth and then by index.

    Args:
        projected: M ellipses.
        features: (M, D).
        opacities: (M,), compensated if antialiased.
        width: width of the image, pixels.
        height: height of the image, pixels.
        preset: generation of gsplat, for the upper bound of alpha.
        tile_size: side of a tile, 16 pixels.
        absgrad: whether the backward pass sets `projected.means2d.absgrad`.

    Returns:
        The image. Its counts: `pairs` of tile and Gaussian; `processed_pairs` among them; `processed_blocks`, pairs of
        a block of 4 x 4 pixels and a Gaussian; `stopped_tiles`, tiles that ended before their last Gaussian.

    Raises:
        UsageError: a tile size other than 16.
    """
    if tile_size != TILE_PX:
        raise UsageError(
            f"tiles of {tile_size} pixels",
            place="tile_size",
            expected=f"{TILE_PX} on the CPU",
            remedy="leave tile_size out, or take backend='reference'",
        )
    image, alpha, counts = _Blend.apply(
        projected.means2d, projected.conics, features, opacities, projected, width, height, preset.alpha_max, absgrad
    )
    return BlendedImage(image, alpha, counts)


class _Slice(NamedTuple):
    """A slice of Gaussians that follow each other in depth.

    Attributes:
        order: (R,) indices of the Gaussians.
        tiles: their pairs with the tiles that were not done before the slice.
        counts_before: (T,) number of Gaussians of each tile in earlier slices.
        processed_end: (T,) one past the last processed pair of each tile.
    """

    order: Int32
    tiles: Tiles
    counts_before: Int32
    processed_end: Int64


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any,
        means2d: Tensor,
        conics: Tensor,
        features: Tensor,
        opacities: Tensor,
        projected: ProjectedGaussians,
        width: int,
        height: int,
        alpha_max: float,
        absgrad: bool,
    ) -> tuple[Tensor, Tensor, dict[str, int]]:
        canvas = make_canvas(width, height, max(4, features.shape[1]))
        values = opacities.detach().numpy()
        splats = pack_splats(
            means2d.detach().numpy(),
            projected.means2d_low.numpy(),
            projected.factors.numpy(),
            values,
            features.detach().contiguous().numpy(),
            projected.radii.numpy(),
            canvas.tiles_x,
            canvas.tiles_y,
        )
        order, slices, work = depth_order(projected.depths.detach().numpy()), [], np.zeros(2, np.int64)
        image, alpha, write_row = canvas.make_image(features.shape[1])
        is_written = False
        for part in _slices(order):
            if not canvas.alive.any():
                break
            is_written = part[-1:].tobytes() == order[-1:].tobytes()
            slices.append(_blend_slice(canvas, splats, part, alpha_max, work, write_row if is_written else None))
        if not is_written:
            in_parallel(write_row, canvas.tiles_y)
        context.saved = (means2d, values, splats, slices, canvas, image.shape, alpha_max, absgrad)
        context.set_materialize_grads(False)
        counts = {
            "pairs": sum(len(part.tiles.pair_ranks) for part in slices),
            "processed_pairs": int(work[0]),
            "processed_blocks": int(work[1]),
            "stopped_tiles": int((~canvas.alive).sum()),
        }
        return torch.from_numpy(image), torch.from_numpy(alpha), counts

    @staticmethod
    @once_differentiable
    def backward(context: Any, grad_image: Tensor | None, grad_alpha: Tensor | None, _: None) -> tuple[Any, ...]:
        means2d, opacities, splats, slices, canvas, shape, alpha_max, absgrad = context.saved
        gradients = _Gradients.zeros(len(opacities), shape[2])
        grad_colours, transmittance, background_sum, convert_row = canvas.make_gradients(
            _to_array(grad_image, shape), _to_array(grad_alpha, shape[:2])
        )
        first_lines = _first_lines(slices, len(opacities))
        line_size = LANES * -(-(SUMS + splats.channels) // LANES)
        lines = empty_aligned(first_lines[-1] * line_size)
        for part in reversed(slices):
            _backward_slice(
                canvas,
                convert_row if part is slices[-1] else None,
                splats,
                part,
                alpha_max,
                grad_colours,
                transmittance,
                background_sum,
                first_lines,
                lines,
                line_size,
                absgrad,
            )
        _reduce_gradients(splats, opacities, first_lines, lines, line_size, gradients)
        if absgrad:
            means2d.absgrad = torch.from_numpy(gradients.absolute)
        return (*map(torch.from_numpy, gradients[:4]), None, None, None, None, None)


class _Gradients(NamedTuple):
    """The gradients to M Gaussians.

    Attributes:
        means: (M, 2).
        conics: (M, 3).
        features: (M, D).
        opacities: (M,).
        absolute: (M, 2) sums of each pixel's absolute gradient to the means.
    """

    means: Float32
    conics: Float64
    features: Float32
    opacities: Float32
    absolute: Float32

    @classmethod
    def zeros(cls, count: int, channels: int) -> _Gradients:
        """Make gradients of zero."""
        return cls(
            np.zeros((count, 2), np.float32),
            np.zeros((count, 3), np.float64),
            np.zeros((count, channels), np.float32),
            np.zeros(count, np.float32),
            np.zeros((count, 2), np.float32),
        )


def _to_array(gradient: Tensor | None, shape: tuple[int, ...]) -> Float32:
    """Convert a gradient to an array; zeros if there is none."""
    return np.zeros(shape, np.float32) if gradient is None else gradient.detach().contiguous().numpy()


def _slices(order: Int32) -> Iterator[Int32]:
    """Yield slices of growing size in depth order, so that hidden Gaussians are never paired with tiles."""
    first, size = 0, max(LEAST_SLICE, -(-len(order) // _SHARE))
    while first < len(order):
        end = len(order) if len(order) - first < 2 * size else first + size
        yield order[first:end]
        first, size = end, 2 * size


def _tile_rows(canvas: Canvas) -> Int64:
    """Make the indices of the tiles (tiles_y, tiles_x)."""
    return np.arange(len(canvas.alive)).reshape(canvas.tiles_y, canvas.tiles_x)


def _blend_slice(
    canvas: Canvas,
    splats: Splats,
    order: Int32,
    alpha_max: float,
    work: Int64,
    write_row: Callable[[int], None] | None,
) -> _Slice:
    """Blend Gaussians into all tiles that are not done; add processed pairs and processed blocks to `work`.

    Each row of tiles is written to the image then, if this slice is the last one.
    """
    tiles = assign_tiles(splats, order, canvas.tiles_x, canvas.alive)
    part = _Slice(order, tiles, canvas.counts_before.copy(), tiles.tile_starts[:-1].copy())
    numbers, counts = _tile_rows(canvas), np.zeros((canvas.tiles_y, 2), np.int64)
    found = np.diff(tiles.tile_starts).astype(np.int32)
    canvas.counts_before[:] += found
    has_pairs: list[bool] = np.any(found.reshape(numbers.shape), axis=1).tolist()
    placements = empty_aligned(canvas.tiles_y * BATCH * PLACEMENT_SIZE).reshape(canvas.tiles_y, -1)
    block_bits, gaussian_bits = (
        np.empty((canvas.tiles_y, BATCH), np.int32),
        np.empty((canvas.tiles_y, BLOCKS), np.uint64),
    )

    def blend_row(row: int) -> None:
        if has_pairs[row]:
            blend_tiles(
                numbers[row], tiles.tile_starts, tiles.ids, part.counts_before, splats.rows, splats.stride,
                splats.channels, canvas.tiles_x, canvas.width, canvas.height, alpha_max, canvas.transmittance,
                canvas.colours, canvas.last, canvas.alive, placements[row], block_bits[row], gaussian_bits[row],
                part.processed_end, counts[row],
            )  # fmt: skip
        if write_row is not None:
            write_row(row)

    in_parallel(blend_row, canvas.tiles_y)
    work += counts.sum(axis=0)
    return part


def _first_lines(slices: list[_Slice], count: int) -> Int64:
    """Compute the first line (M + 1,) of each Gaussian; it has one line per tile."""
    first_lines = np.zeros(count + 1, np.int64)
    for part in slices:
        first_lines[part.order + 1] = part.tiles.pairs
    return np.cumsum(first_lines, out=first_lines)


def _backward_slice(
    canvas: Canvas,
    convert_row: Callable[[int], None] | None,
    splats: Splats,
    part: _Slice,
    alpha_max: float,
    grad_colours: Float32,
    transmittance: Float32,
    background_sum: Float32,
    first_lines: Int64,
    lines: Float32,
    line_size: int,
    absgrad: bool,
) -> None:
    """Write the line of each pair of tile and Gaussian of a slice; the gradients of a row are converted before."""
    tiles, numbers = part.tiles, _tile_rows(canvas)
    has_pairs: list[bool] = np.any(np.diff(tiles.tile_starts).reshape(numbers.shape), axis=1).tolist()
    extra = (line_size - SUMS) * LANES
    placements = empty_aligned(canvas.tiles_y * BATCH * PLACEMENT_SIZE).reshape(canvas.tiles_y, -1)
    block_bits = np.empty((canvas.tiles_y, BATCH), np.int32)
    extra_sums = full_aligned(canvas.tiles_y * extra, 0.0).reshape(canvas.tiles_y, extra)

    def write(row: int) -> None:
        if convert_row is not None:
            convert_row(row)
        if not has_pairs[row]:
            return
        blend_tiles_backward(
            numbers[row], tiles.tile_starts, tiles.ids, tiles.pair_ranks, first_lines, part.counts_before,
            part.processed_end, splats.rows, splats.stride, splats.channels, canvas.tiles_x, alpha_max, transmittance,
            background_sum, grad_colours, canvas.last, placements[row], block_bits[row], extra_sums[row], lines,
            line_size, absgrad,
        )  # fmt: skip

    in_parallel(write, canvas.tiles_y)


def _reduce_gradients(
    splats: Splats, opacities: Float32, first_lines: Int64, lines: Float32, line_size: int, gradients: _Gradients
) -> None:
    """Add the lines of each Gaussian in parallel."""
    edges = spans(len(opacities))
    in_parallel(
        lambda number: reduce_lines(
            edges[number], edges[number + 1], first_lines, lines, line_size, splats.rows, splats.stride, opacities,
            gradients.means, gradients.conics, gradients.opacities, gradients.features, gradients.absolute,
            empty_aligned(line_size),
        ),
        len(edges) - 1,
    )  # fmt: skip
