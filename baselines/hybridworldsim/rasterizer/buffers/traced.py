"""Follow the light of every pixel again, after a picture is rendered, and write down what it meets."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

import torch
from torch import Tensor

from hybridworldsim.rasterizer.limits import positive
from hybridworldsim.rasterizer.meta import Blending
from mirror.errors import UsageError


class Buffers(NamedTuple):
    """What the pixels of pictures show.

    Attributes:
        ids: (..., C, H, W, top) int64 Gaussians of greatest weight, the greatest first, the nearer of equals first; -1
            where there are no more.
        weights: (..., C, H, W, top) of them, 0 where there are no more.
        n_contrib: (..., C, H, W) int32 how many Gaussians were blended.
        median_depth: (..., C, H, W) camera z, metres, of the Gaussian behind which no more than half of the light is
            left; 0 where more passes all.
    """

    ids: Tensor
    weights: Tensor
    n_contrib: Tensor
    median_depth: Tensor


class Traced(NamedTuple):
    """What a backend finds in one picture; Gaussians are rows of what is projected, -1 is none."""

    rows: Tensor  # (H, W, top) int64
    weights: Tensor  # (H, W, top)
    n_contrib: Tensor  # (H, W) int32
    median: Tensor  # (H, W) int64


def blending_of(meta: Mapping[str, Any]) -> Blending:
    """How the pictures of a call were blended.

    Args:
        meta: of `rasterization`.

    Raises:
        UsageError: they were not blended here.
    """
    if "blending" not in meta:
        raise UsageError(
            "gsplat's CUDA kernels do not tell how they blended", place="meta", expected='backend="cpu" or "reference"'
        )
    blending: Blending = meta["blending"]
    return blending


@torch.no_grad()
def trace(meta: Mapping[str, Any], top: int = 1) -> Buffers:
    """The Gaussians that each pixel shows, and its median depth.

    Args:
        meta: of `rasterization` on the CPU.
        top: how many Gaussians of greatest weight to name in every pixel; the first is the id buffer.

    Raises:
        UsageError: `meta` is not of the CPU, or `top` is less than 1.
    """
    blending = blending_of(meta)
    backend = import_module(f"hybridworldsim.rasterizer.buffers.{blending.backend}")
    found: list[Buffers] = []
    for view in blending.views:
        traced: Traced = backend.trace(
            view.projected,
            view.opacities,
            blending.width,
            blending.height,
            preset=blending.preset,
            tile_size=blending.tile_size,
            top=positive("top", top),
        )
        found.append(
            Buffers(
                _taken(view.projected.ids, traced.rows, -1),
                traced.weights,
                traced.n_contrib,
                _taken(view.projected.depths, traced.median, 0),
            )
        )
    return Buffers(*(blending.shaped(torch.stack(pictures)) for pictures in zip(*found, strict=True)))


def _taken(table: Tensor, rows: Tensor, none: int) -> Tensor:
    """Values of rows; `none` for row -1."""
    return torch.cat([table, table.new_full((1,), none)])[rows]
