"""Ellipses to a picture, with gradients."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.rasterizer.blended import Blended
from hybridworldsim.rasterizer.cpu.blending import BATCH, BLOCKS, LANES, PIXELS, PLACED, blend_tiles
from hybridworldsim.rasterizer.cpu.blending_backward import SUMS, blend_tiles_backward, collect
from hybridworldsim.rasterizer.cpu.pixels import from_blocks, into_blocks
from hybridworldsim.rasterizer.cpu.sorting import depth_order
from hybridworldsim.rasterizer.cpu.splats import TILE_PX, Splats, splats_of
from hybridworldsim.rasterizer.cpu.threads import in_parallel
from hybridworldsim.rasterizer.cpu.tiles import Tiles, tiles_of
from hybridworldsim.rasterizer.presets import Preset
from hybridworldsim.rasterizer.projected import Projected
from mirror.arrays import Bool, Float32, Int32, Int64
from mirror.errors import UsageError

_PARTS: Final = 32


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
    """Blend ellipses front to back, by depth and then by index.

    Args:
        projected: M ellipses.
        features: (M, D) of each.
        opacities: (M,) of each, compensated if antialiased.
        width: of the picture, pixels.
        height: of the picture.
        preset: whose cap of alpha is taken.
        tile_size: side of a tile, 16.
        absgrad: whether `projected.means2d.absgrad` is set by the backward pass.

    Returns:
        The picture.

    Raises:
        UsageError: tiles of another size.
    """
    if tile_size != TILE_PX:
        raise UsageError(
            f"tiles of {tile_size} pixels",
            place="tile_size",
            expected=f"{TILE_PX} on the CPU",
            remedy="leave tile_size out, or take backend='reference'",
        )
    image, alpha, last, counts = _Blend.apply(
        projected.means2d, projected.conics, features, opacities, projected, width, height, preset.alpha_max, absgrad
    )
    return Blended(image, alpha, last, counts)


class _Canvas(NamedTuple):
    """A picture as tiles of blocks, in the making.

    Attributes:
        tiles_x: columns of tiles.
        tiles_y: rows of them; T tiles in all.
        light: (T * 256,) what is left of it; negative where a pixel is done.
        colours: (T * channels * 256,).
        last: (T * 256,) the number in its tile of the hindmost Gaussian of a pixel; -1 if it has none.
        alive: (T,) whether not all of a tile's pixels are done.
    """

    tiles_x: int
    tiles_y: int
    light: Float32
    colours: Float32
    last: Int32
    alive: Bool


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any,
        means2d: Tensor,
        conics: Tensor,
        features: Tensor,
        opacities: Tensor,
        projected: Projected,
        width: int,
        height: int,
        alpha_max: float,
        absgrad: bool,
    ) -> tuple[Tensor, Tensor, Tensor, dict[str, int]]:
        canvas = _blank(width, height, max(4, features.shape[1]))
        values = opacities.detach().numpy()
        splats = splats_of(
            means2d.detach().numpy(),
            projected.means2d_low.numpy(),
            projected.factors.numpy(),
            values,
            features.detach().contiguous().numpy(),
            projected.radii.numpy(),
            canvas.tiles_x,
            canvas.tiles_y,
        )
        order = depth_order(projected.depths.detach().numpy())
        tiles = tiles_of(splats, order, canvas.tiles_x, canvas.alive)
        seen = _blended(canvas, splats, tiles, alpha_max)
        image = np.empty((height, width, features.shape[1]), np.float32)
        alpha = np.empty((height, width), np.float32)
        last = np.empty((height, width), np.int32)
        in_parallel(
            lambda row: from_blocks(
                row, canvas.colours, canvas.light, canvas.last, tiles.begins, tiles.ids, splats.channels,
                canvas.tiles_x, image, alpha, last,
            ),
            canvas.tiles_y,
        )  # fmt: skip
        context.saved = (means2d, values, splats, order, tiles, canvas, alpha_max, absgrad)
        context.shape = image.shape
        context.set_materialize_grads(False)
        counts = {
            "pairs": len(tiles.slots),
            "processed_pairs": int(seen[0]),
            "processed_blocks": int(seen[1]),
            "stopped_tiles": int((~canvas.alive).sum()),
        }
        return torch.from_numpy(image), torch.from_numpy(alpha), torch.from_numpy(last), counts

    @staticmethod
    def backward(context: Any, by_image: Tensor | None, by_alpha: Tensor | None, *_: None) -> tuple[Any, ...]:
        means2d, opacities, splats, order, tiles, canvas, alpha_max, absgrad = context.saved
        channels = splats.channels
        light, behind = np.empty_like(canvas.light), np.empty_like(canvas.light)
        gradient = np.zeros_like(canvas.colours)
        height, width, wide = context.shape
        image = _array(by_image, (height, width, wide))
        alpha = _array(by_alpha, (height, width))
        in_parallel(
            lambda row: into_blocks(row, image, alpha, canvas.light, channels, canvas.tiles_x, gradient, light, behind),
            canvas.tiles_y,
        )
        lines, line = _lines(splats, tiles, canvas, alpha_max, light, behind, gradient)
        count = len(order)
        by_mean, by_conic = np.zeros((count, 2), np.float32), np.zeros((count, 3), np.float64)
        by_opacity, by_feature = np.zeros(count, np.float32), np.zeros((count, wide), np.float32)
        absolute = np.zeros((count, 2), np.float32)
        edges = np.linspace(0, count, _PARTS + 1).astype(np.int64)
        in_parallel(
            lambda part: collect(
                edges[part], edges[part + 1], order, tiles.firsts, lines, line, splats.rows, splats.stride, opacities,
                by_mean, by_conic, by_opacity, by_feature, absolute, np.empty(SUMS + wide),
            ),
            _PARTS,
        )  # fmt: skip
        if absgrad:
            means2d.absgrad = torch.from_numpy(absolute)
        found = (by_mean, by_conic, by_feature, by_opacity)
        return (*map(torch.from_numpy, found), None, None, None, None, None)


def _array(gradient: Tensor | None, shape: tuple[int, ...]) -> Float32:
    return np.zeros(shape, np.float32) if gradient is None else gradient.detach().contiguous().numpy()


def _blank(width: int, height: int, channels: int) -> _Canvas:
    tiles_x, tiles_y = -(-width // TILE_PX), -(-height // TILE_PX)
    count = tiles_x * tiles_y
    return _Canvas(
        tiles_x,
        tiles_y,
        np.ones(count * PIXELS, np.float32),
        np.zeros(count * PIXELS * channels, np.float32),
        np.full(count * PIXELS, -1, np.int32),
        np.ones(count, np.bool_),
    )


def _blended(canvas: _Canvas, splats: Splats, tiles: Tiles, alpha_max: float) -> Int64:
    """Blend the Gaussians of all tiles; how many places were looked at, and pairs of block and Gaussian."""
    numbers = np.arange(len(canvas.alive)).reshape(canvas.tiles_y, canvas.tiles_x)
    seen, base = np.zeros((canvas.tiles_y, 2), np.int64), np.zeros(len(canvas.alive), np.int32)

    def blend_row(row: int) -> None:
        blend_tiles(
            numbers[row], tiles.begins, tiles.ids, base, splats.rows, splats.stride, splats.channels, canvas.tiles_x,
            alpha_max, canvas.light, canvas.colours, canvas.last, canvas.alive, np.empty(BATCH * PLACED, np.float32),
            np.empty(BATCH, np.int32), np.empty(BLOCKS, np.uint64), seen[row],
        )  # fmt: skip

    in_parallel(blend_row, canvas.tiles_y)
    return seen.sum(axis=0)


def _lines(
    splats: Splats, tiles: Tiles, canvas: _Canvas, alpha_max: float, light: Float32, behind: Float32, gradient: Float32
) -> tuple[Float32, int]:
    """The gradients of each pair of tile and Gaussian, and how many numbers each has."""
    line = LANES * -(-(SUMS + splats.channels) // LANES)
    lines = np.empty(len(tiles.slots) * line, np.float32)
    numbers = np.arange(len(canvas.alive)).reshape(canvas.tiles_y, canvas.tiles_x)
    base = np.zeros(len(canvas.alive), np.int32)

    def go_back(row: int) -> None:
        blend_tiles_backward(
            numbers[row], tiles.begins, tiles.ids, tiles.slots, base, splats.rows, splats.stride, splats.channels,
            canvas.tiles_x, alpha_max, light, behind, gradient, canvas.last, np.empty(BATCH * PLACED, np.float32),
            np.empty(BATCH, np.int32), np.empty(splats.channels * LANES, np.float32), lines, line,
        )  # fmt: skip

    in_parallel(go_back, canvas.tiles_y)
    return lines, line
