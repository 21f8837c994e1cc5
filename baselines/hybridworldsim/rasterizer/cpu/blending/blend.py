"""Ellipses to a picture, with gradients."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.memory import filled, room
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.rasterizer.blended import Blended
from hybridworldsim.rasterizer.cpu.blending.backward import SUMS, blend_tiles_backward, collect
from hybridworldsim.rasterizer.cpu.blending.canvas import BLOCKS, LANES, TILE_PX, Canvas, blank
from hybridworldsim.rasterizer.cpu.blending.forward import BATCH, PLACED, blend_tiles
from hybridworldsim.rasterizer.cpu.blending.sorting import depth_order
from hybridworldsim.rasterizer.cpu.blending.splats import Splats, splats_of
from hybridworldsim.rasterizer.cpu.blending.tiles import Tiles, tiles_of
from hybridworldsim.rasterizer.presets import Preset
from hybridworldsim.rasterizer.projected import Projected
from mirror.arrays import Float32, Float64, Int32, Int64
from mirror.errors import UsageError

_PARTS: Final = 32
_SLICE: Final = 32768
"""Gaussians of the nearest slice, at least."""

_SHARE: Final = 8
"""All Gaussians are so many times those of the nearest slice, where there are many."""


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
        The picture. Its counts: pairs of tile and Gaussian; those that were looked at; pairs of a block of 4 x 4 pixels
        and a Gaussian that were blended; tiles that were done before their last Gaussian.

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
    image, alpha, counts = _Blend.apply(
        projected.means2d, projected.conics, features, opacities, projected, width, height, preset.alpha_max, absgrad
    )
    return Blended(image, alpha, counts)


class _Slice(NamedTuple):
    """Gaussians that are neighbours in depth.

    Attributes:
        order: (R,) which ones.
        tiles: the tiles that they reach, of those that were not done before.
        passed: (T,) how many Gaussians of each tile came before.
        until: (T,) the place in front of which the last Gaussian is that was looked at.
    """

    order: Int32
    tiles: Tiles
    passed: Int32
    until: Int64


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
    ) -> tuple[Tensor, Tensor, dict[str, int]]:
        canvas = blank(width, height, max(4, features.shape[1]))
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
        order, slices, seen = depth_order(projected.depths.detach().numpy()), [], np.zeros(2, np.int64)
        for part in _slices(order):
            if not canvas.alive.any():
                break
            slices.append(_blended(canvas, splats, part, alpha_max, seen))
        image, alpha = canvas.picture(features.shape[1])
        context.saved = (means2d, values, splats, slices, canvas, image.shape, alpha_max, absgrad)
        context.set_materialize_grads(False)
        counts = {
            "pairs": sum(len(part.tiles.turns) for part in slices),
            "processed_pairs": int(seen[0]),
            "processed_blocks": int(seen[1]),
            "stopped_tiles": int((~canvas.alive).sum()),
        }
        return torch.from_numpy(image), torch.from_numpy(alpha), counts

    @staticmethod
    @once_differentiable
    def backward(context: Any, by_image: Tensor | None, by_alpha: Tensor | None, _: None) -> tuple[Any, ...]:
        means2d, opacities, splats, slices, canvas, shape, alpha_max, absgrad = context.saved
        found = _Gradients.none(len(opacities), shape[2])
        to_colours, light, behind = canvas.gradients(_array(by_image, shape), _array(by_alpha, shape[:2]))
        firsts = _firsts(slices, len(opacities))
        line = LANES * -(-(SUMS + splats.channels) // LANES)
        lines = room(firsts[-1] * line)
        for part in reversed(slices):
            _go_back(canvas, splats, part, alpha_max, to_colours, light, behind, firsts, lines, line, absgrad)
        _collect(splats, opacities, firsts, lines, line, found)
        if absgrad:
            means2d.absgrad = torch.from_numpy(found.absolute)
        return (*map(torch.from_numpy, found[:4]), None, None, None, None, None)


class _Gradients(NamedTuple):
    """Of M Gaussians.

    Attributes:
        means: (M, 2).
        conics: (M, 3).
        features: (M, D).
        opacities: (M,).
        absolute: (M, 2) to the means, each pixel's taken without its sign.
    """

    means: Float32
    conics: Float64
    features: Float32
    opacities: Float32
    absolute: Float32

    @classmethod
    def none(cls, count: int, channels: int) -> _Gradients:
        """Of Gaussians that nothing shows."""
        return cls(
            np.zeros((count, 2), np.float32),
            np.zeros((count, 3), np.float64),
            np.zeros((count, channels), np.float32),
            np.zeros(count, np.float32),
            np.zeros((count, 2), np.float32),
        )


def _array(gradient: Tensor | None, shape: tuple[int, ...]) -> Float32:
    return np.zeros(shape, np.float32) if gradient is None else gradient.detach().contiguous().numpy()


def _slices(order: Int32) -> Iterator[Int32]:
    """Gaussians in depth order by slices that grow: what the first ones hide is never paired with tiles."""
    first, size = 0, max(_SLICE, -(-len(order) // _SHARE))
    while first < len(order):
        end = len(order) if len(order) - first < 2 * size else first + size
        yield order[first:end]
        first, size = end, 2 * size


def _tile_rows(canvas: Canvas) -> Int64:
    """The numbers of tiles (tiles_y, tiles_x)."""
    return np.arange(len(canvas.alive)).reshape(canvas.tiles_y, canvas.tiles_x)


def _blended(canvas: Canvas, splats: Splats, order: Int32, alpha_max: float, seen: Int64) -> _Slice:
    """Blend Gaussians into all tiles that are not done; counts what was looked at, and pairs of block and Gaussian."""
    tiles = tiles_of(splats, order, canvas.tiles_x, canvas.alive)
    part = _Slice(order, tiles, canvas.passed.copy(), np.empty(len(canvas.alive), np.int64))
    numbers, counts = _tile_rows(canvas), np.zeros((canvas.tiles_y, 2), np.int64)

    def blend_row(row: int) -> None:
        blend_tiles(
            numbers[row], tiles.begins, tiles.ids, part.passed, splats.rows, splats.stride, splats.channels,
            canvas.tiles_x, alpha_max, canvas.light, canvas.colours, canvas.last, canvas.alive,
            room(BATCH * PLACED), room(BATCH, np.int32), room(BLOCKS, np.uint64), part.until,
            counts[row],
        )  # fmt: skip

    in_parallel(blend_row, canvas.tiles_y)
    canvas.passed[:] += np.diff(tiles.begins).astype(np.int32)
    seen += counts.sum(axis=0)
    return part


def _firsts(slices: list[_Slice], count: int) -> Int64:
    """Where the lines (M + 1,) of each Gaussian begin: one for each of its tiles."""
    firsts = np.zeros(count + 1, np.int64)
    for part in slices:
        firsts[part.order + 1] = part.tiles.pairs
    return np.cumsum(firsts, out=firsts)


def _go_back(
    canvas: Canvas,
    splats: Splats,
    part: _Slice,
    alpha_max: float,
    to_colours: Float32,
    light: Float32,
    behind: Float32,
    firsts: Int64,
    lines: Float32,
    line: int,
    absgrad: bool,
) -> None:
    """Write the gradients of each pair of tile and Gaussian of a slice."""
    tiles, numbers = part.tiles, _tile_rows(canvas)

    def write(row: int) -> None:
        blend_tiles_backward(
            numbers[row], tiles.begins, tiles.ids, tiles.turns, firsts, part.passed, part.until, splats.rows,
            splats.stride, splats.channels, canvas.tiles_x, alpha_max, light, behind, to_colours, canvas.last,
            room(BATCH * PLACED), room(BATCH, np.int32), filled((line - SUMS) * LANES, 0.0), lines, line, absgrad,
        )  # fmt: skip

    in_parallel(write, canvas.tiles_y)


def _collect(splats: Splats, opacities: Float32, firsts: Int64, lines: Float32, line: int, found: _Gradients) -> None:
    """Add up the lines of each Gaussian."""
    edges = np.linspace(0, len(opacities), _PARTS + 1).astype(np.int64)
    in_parallel(
        lambda number: collect(
            edges[number], edges[number + 1], firsts, lines, line, splats.rows, splats.stride, opacities, found.means,
            found.conics, found.opacities, found.features, found.absolute, room(line),
        ),
        _PARTS,
    )  # fmt: skip
