"""Normals: the shortest axes of Gaussians, turned to the camera and blended as colours are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from hybridworldsim.rasterizer.buffers.traced import blending_of
from hybridworldsim.rasterizer.presets import QUATERNION_MAX, QUATERNION_MIN
from hybridworldsim.rasterizer.rendering import backend_named
from hybridworldsim.rasterizer.rows import rows

_LENGTH_MIN = 1e-6
"""Added to the length by which normals are divided: where nothing is seen they are zero, not NaN."""


def facing_axes(means: Tensor, quats: Tensor, scales: Tensor, viewmats: Tensor) -> Tensor:
    """The shortest axis of each Gaussian in each camera's frame, turned to the camera.

    Colours for `rasterization`: beside others in one call, or alone.

    Args:
        means: (..., N, 3).
        quats: (..., N, 4) scalar first, of any length from 1e-30 to 1e150.
        scales: (..., N, 3); of equal ones the first axis counts. No gradient: an axis only changes by jumps.
        viewmats: (..., C, 4, 4) camera from world.

    Returns:
        (..., C, N, 3) unit vectors, x right, y down, z forward; zero for a quaternion that is no rotation.
    """
    axes = _shortest_axes(quats, scales)[..., None, :, :]  # (..., 1, N, 3)
    rotations = viewmats[..., :3, :3]
    axes = axes @ rotations.transpose(-1, -2).to(axes.dtype)  # (..., C, N, 3)
    with torch.no_grad():
        positions = -torch.linalg.solve(rotations.double(), viewmats[..., :3, 3].double())  # (..., C, 3)
        offsets = means[..., None, :, :].double() - positions[..., None, :]
        toward = offsets @ rotations.transpose(-1, -2).double()  # (..., C, N, 3)
        away = (toward * axes).sum(-1, keepdim=True) > 0.0
    return torch.where(away, -axes, axes)


def normals(meta: Mapping[str, Any], means: Tensor, quats: Tensor, scales: Tensor, viewmats: Tensor) -> Tensor:
    """Pictures of normals, of what `rasterization` has projected: nothing is projected again.

    Args:
        meta: of `rasterization` on the CPU.
        means: (..., N, 3) as it was given.
        quats: (..., N, 4) as it was given.
        scales: (..., N, 3) as it was given.
        viewmats: (..., C, 4, 4) as it was given.

    Returns:
        (..., C, H, W, 3) in each camera's frame, of length one where something is seen and zero where nothing is;
        differentiable to quats, viewmats and all that the ellipses depend on.

    Raises:
        UsageError: `meta` is not of the CPU.
    """
    blending = blending_of(meta)
    backend = backend_named(blending.backend)
    count = math.prod(means.shape[:-2])
    scenes = [table.reshape(count, *table.shape[-2:]) for table in (means, quats, scales)]
    cameras = viewmats.reshape(count, viewmats.shape[-3], 4, 4)
    pictures = []
    for view in blending.views:
        scene, camera = view.place
        centres, rotations, sizes = (rows(table[scene], view.projected.ids) for table in scenes)
        axes = facing_axes(centres, rotations, sizes, cameras[scene, camera][None])[0]
        blended = backend.blend(
            view.projected,
            axes.to(view.projected.means2d.dtype),
            view.opacities,
            blending.width,
            blending.height,
            preset=blending.preset,
            tile_size=blending.tile_size,
            absgrad=False,
        )
        pictures.append(normalised(blended.image))
    return blending.shaped(torch.stack(pictures))


def normalised(blended: Tensor) -> Tensor:
    """Blended axes (..., 3) as normals: of length one to 1e-6 of the weight, zero where the weight is."""
    squares = blended.square().sum(-1, keepdim=True)
    return blended / (squares + _LENGTH_MIN**2).sqrt()


def _shortest_axes(quats: Tensor, scales: Tensor) -> Tensor:
    """(..., N, 3) columns of the rotations of quaternions (..., N, 4): those of the smallest scales."""
    squares = quats.double().square().sum(-1)
    sound = (squares >= QUATERNION_MIN**2) & (squares <= QUATERNION_MAX**2)
    units = quats.double() / torch.where(sound, squares, 1.0).sqrt()[..., None]
    w, x, y, z = torch.where(sound[..., None], units, 0.0).to(quats.dtype).unbind(-1)
    norm = torch.where(sound, 1.0, 0.0).to(quats.dtype)
    columns = torch.stack(
        [
            torch.stack([norm - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)], dim=-1),
            torch.stack([2.0 * (x * y - w * z), norm - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)], dim=-1),
            torch.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), norm - 2.0 * (x * x + y * y)], dim=-1),
        ],
        dim=-2,
    )  # (..., N, axis, 3)
    shortest = scales.detach().abs().argmin(-1)[..., None, None].expand(*quats.shape[:-1], 1, 3)
    return columns.gather(-2, shortest)[..., 0, :]
