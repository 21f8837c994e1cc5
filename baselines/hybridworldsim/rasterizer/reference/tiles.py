"""Assigns Gaussians to the tiles of an image, front to back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor

from hybridworldsim.rasterizer.presets import ALPHA_MIN, GsplatPreset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians

CHUNK = 256
"""Number of Gaussians that are evaluated at once, at all pixels of a tile."""

_SLACK = 1e-3
"""Bound of the rounding error of a needle's least form; a tile that is kept needlessly only costs time."""


@contextmanager
def single_thread() -> Iterator[None]:
    """Make torch compute in the calling thread, because a chunk is too small for several threads.

    On a machine with two busy cores two threads were 20 to 50 times slower than one.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class Tile(NamedTuple):
    """A tile with at least one Gaussian, and its range [begin, end) in a list of pairs."""

    pixels: Tensor  # (P,) int64, row-major in the image
    centres: Tensor  # (P, 2) pixels
    begin: int
    end: int

    def chunks(self) -> Iterator[slice]:
        """Split the range into chunks, front to back."""
        for begin in range(self.begin, self.end, CHUNK):
            yield slice(begin, min(begin + CHUNK, self.end))


def sort_front_to_back(projected: ProjectedGaussians) -> Tensor:
    """Sort rows (M,) by float32 depth, then by index: the order of gsplat's sort keys."""
    return torch.argsort(projected.depths.detach().float(), stable=True)


def pair_tiles(
    projected: ProjectedGaussians, opacities: Tensor, width: int, height: int, *, preset: GsplatPreset, tile_size: int
) -> tuple[Tensor, list[Tile]]:
    """Pair each tile with the Gaussians that reach it.

    Args:
        projected: M Gaussians.
        opacities: (M,) compensated opacities.
        width: width of the image, pixels.
        height: height of the image, pixels.
        preset: with square extents a Gaussian reaches each tile that its square touches; with elliptic extents, each
            tile with a pixel at which alpha may reach `ALPHA_MIN`.
        tile_size: side of a tile, pixels.

    Returns:
        Rows (P,) of `projected`, by tile, then front to back; and the tiles with at least one Gaussian.
    """
    tiles_wide, tiles_high = -(-width // tile_size), -(-height // tile_size)
    size = torch.tensor([tiles_wide, tiles_high])
    order = sort_front_to_back(projected)
    means = (projected.means2d.detach().double() + projected.means2d_low)[order]
    radii = projected.radii[order].double()
    first = ((means - radii) / tile_size).floor().clamp(min=0.0).minimum(size).long()  # (M, 2)
    last = ((means + radii) / tile_size).ceil().clamp(min=0.0).minimum(size).long()
    spans = last - first
    areas = spans.prod(-1)  # (M,)

    owner = torch.repeat_interleave(areas)  # (P,)
    within = torch.arange(len(owner)) - (areas.cumsum(0) - areas)[owner]
    wide = spans[owner, 0]
    column = first[owner, 0] + within % wide
    row = first[owner, 1] + within // wide
    if preset.extent == "ellipse":
        at = torch.stack([column, row], dim=-1)  # (P, 2)
        near = at * tile_size + 0.5 - means[owner]
        least = _min_form(near, near + (tile_size - 1), projected.conics.detach().double()[order][owner])
        form = 2.0 * (opacities.detach().double() / ALPHA_MIN).log()[order]
        reached = least <= form[owner] + _SLACK
        owner, column, row = owner[reached], column[reached], row[reached]
    tile, by_tile = torch.sort(row * tiles_wide + column, stable=True)
    starts = torch.searchsorted(tile, torch.arange(tiles_wide * tiles_high + 1)).tolist()

    image_pixels = torch.arange(width * height).view(height, width)
    paired_tiles = []
    for index in range(tiles_wide * tiles_high):
        if starts[index] < starts[index + 1]:
            top, left = (index // tiles_wide) * tile_size, (index % tiles_wide) * tile_size
            pixels = image_pixels[top : top + tile_size, left : left + tile_size].flatten()
            centres = torch.stack([pixels % width, pixels // width], dim=-1) + 0.5
            paired_tiles.append(Tile(pixels, centres.double(), starts[index], starts[index + 1]))
    return order[owner[by_tile]], paired_tiles


def _min_form(low: Tensor, high: Tensor, conics: Tensor) -> Tensor:
    """Compute the minimum (P,) of the quadratic form of `conics` (P, 3) over rectangles from `low` to `high` (P, 2).

    The minimum lies on one of the two sides that face the origin; on each side a parabola has its minimum.
    """
    xx, xy, yy = conics.unbind(-1)
    sides = torch.zeros_like(low).clamp(low, high)
    x, y = sides.unbind(-1)
    y_at_x = (-xy * x / yy).clamp(low[:, 1], high[:, 1])
    x_at_y = (-xy * y / xx).clamp(low[:, 0], high[:, 0])
    forms = [xx * u * u + 2.0 * xy * u * v + yy * v * v for u, v in ((x, y_at_x), (x_at_y, y))]
    return torch.minimum(*forms)


def compute_alphas(x: Tensor, y: Tensor, conics: Tensor, opacities: Tensor, alpha_max: float) -> Tensor:
    """Compute the alphas of L Gaussians at P pixels.

    Args:
        x: (L, P) mean minus pixel centre, pixels.
        y: (L, P) mean minus pixel centre, pixels.
        conics: (L, 3).
        opacities: (L,).
        alpha_max: upper bound; at the bound there is no gradient.

    Returns:
        (L, P), before the cut at `ALPHA_MIN`.
    """
    xx, xy, yy = (column[:, None] for column in conics.unbind(-1))
    power = 0.5 * (xx * x * x + yy * y * y) + xy * x * y
    # gsplat skips a negative power, which can only come from rounding
    return torch.where(power >= 0.0, (opacities[:, None] * torch.exp(-power)).clamp(max=alpha_max), 0.0)
