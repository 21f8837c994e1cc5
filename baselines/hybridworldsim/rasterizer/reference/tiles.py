"""Which Gaussians each tile of a picture is given, front to back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor

from hybridworldsim.rasterizer.presets import ALPHA_MIN, Preset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians

CHUNK = 256
"""Gaussians that are evaluated at once, over all pixels of a tile."""

_SLACK = 1e-3
"""By how much rounding may misjudge the least form of a needle; a tile that is kept in vain costs time only."""


@contextmanager
def single_thread() -> Iterator[None]:
    """Let torch compute in the calling thread: a chunk is too small to share.

    Measured with two threads on a machine whose two cores were busy: 20 to 50 times slower than with one.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class Tile(NamedTuple):
    """A tile that some Gaussian may reach, with its span [begin, end) in a list of pairs."""

    pixels: Tensor  # (P,) int64, row-major in the picture
    centres: Tensor  # (P, 2) pixels
    begin: int
    end: int

    def chunks(self) -> Iterator[slice]:
        """The span in pieces, front to back."""
        for begin in range(self.begin, self.end, CHUNK):
            yield slice(begin, min(begin + CHUNK, self.end))


def sort_front_to_back(projected: ProjectedGaussians) -> Tensor:
    """Rows (M,) by float32 depth, then by index: the order that gsplat's sort keys give."""
    return torch.argsort(projected.depths.detach().float(), stable=True)


def pair_tiles(
    projected: ProjectedGaussians, opacities: Tensor, width: int, height: int, *, preset: Preset, tile_size: int
) -> tuple[Tensor, list[Tile]]:
    """Pair every tile with the Gaussians that the preset lets reach it.

    Args:
        projected: M Gaussians.
        opacities: (M,) with compensations already multiplied in.
        width: pixels.
        height: pixels.
        preset: with square extents, whatever tile the square touches; with elliptic ones, whatever tile has a pixel at
            which alpha may reach `ALPHA_MIN`.
        tile_size: pixels.

    Returns:
        Rows (P,) in `projected`, by tile, then front to back; the tiles that have any.
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

    picture = torch.arange(width * height).view(height, width)
    some = []
    for index in range(tiles_wide * tiles_high):
        if starts[index] < starts[index + 1]:
            top, left = (index // tiles_wide) * tile_size, (index % tiles_wide) * tile_size
            pixels = picture[top : top + tile_size, left : left + tile_size].flatten()
            centres = torch.stack([pixels % width, pixels // width], dim=-1) + 0.5
            some.append(Tile(pixels, centres.double(), starts[index], starts[index + 1]))
    return order[owner[by_tile]], some


def _min_form(low: Tensor, high: Tensor, conics: Tensor) -> Tensor:
    """The least (P,) of the quadratic form of `conics` (P, 3) over rectangles from `low` to `high` (P, 2).

    It is taken on the side that faces the origin, where the form in the other coordinate is least: one of two sides.
    """
    xx, xy, yy = conics.unbind(-1)
    sides = torch.zeros_like(low).clamp(low, high)
    x, y = sides.unbind(-1)
    y_at_x = (-xy * x / yy).clamp(low[:, 1], high[:, 1])
    x_at_y = (-xy * y / xx).clamp(low[:, 0], high[:, 0])
    forms = [xx * u * u + 2.0 * xy * u * v + yy * v * v for u, v in ((x, y_at_x), (x_at_y, y))]
    return torch.minimum(*forms)


def compute_alphas(x: Tensor, y: Tensor, conics: Tensor, opacities: Tensor, alpha_max: float) -> Tensor:
    """What L Gaussians would take of the light of P pixels.

    Args:
        x: (L, P) mean less pixel centre.
        y: (L, P).
        conics: (L, 3).
        opacities: (L,).
        alpha_max: cap; where it holds, no gradient passes.

    Returns:
        (L, P), not yet cut off at `ALPHA_MIN`.
    """
    xx, xy, yy = (column[:, None] for column in conics.unbind(-1))
    power = 0.5 * (xx * x * x + yy * y * y) + xy * x * y
    # gsplat skips a negative power, which only rounding makes
    return torch.where(power >= 0.0, (opacities[:, None] * torch.exp(-power)).clamp(max=alpha_max), 0.0)
