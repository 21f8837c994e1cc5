"""Decoding of anchors and Code-Gaussians in plain torch, differentiable, in any precision and on any device."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.trainable.viewpoint import Viewpoint

_LEAST_M = 1e-12
_MULTIPLE = 4


def anchors_to_gaussians(
    geometry: Tensor, colours: Tensor, means: Tensor, offsets: Tensor, log_scales: Tensor
) -> tuple[Tensor, ...]:
    """Compute the Gaussians of anchors; see `hybridworldsim.model.nodes.gaussian_assembly.anchors_to_gaussians`.

    Returns:
        Means, quats, scales, opacities, colours and slots.
    """
    k = offsets.shape[1]
    numbers = geometry.reshape(-1, geometry.shape[1] // k)
    slots = (numbers[:, 0] > 0.0).nonzero().squeeze(1)
    # The gradient of a selection is a sum of rows; that of an index is sorted first.
    parents, own = slots // k, numbers.index_select(0, slots)
    sizes = log_scales.index_select(0, parents).exp()
    return (
        means.index_select(0, parents) + offsets.reshape(-1, 3).index_select(0, slots) * sizes[:, :3],
        own[:, 4:],
        sizes[:, 3:] * own[:, 1:4].sigmoid(),
        own[:, 0].tanh(),
        colours.reshape(-1, 3).index_select(0, slots).sigmoid(),
        slots,
    )


def rows_of_slots(slots: Tensor, ids: Tensor, k: int) -> Tensor:
    """Return the rows (G,), among all Gaussians of a node, of slots (G,) of anchors ``ids`` (M,)."""
    return ids[slots // k] * k + slots % k


def network_inputs(codes: Tensor, means: Tensor, eye: Tensor, radius_m: float | None) -> Tensor:
    """Compute the inputs of a network; see `hybridworldsim.model.nodes.network_inputs.network_inputs`.

    Only the codes get a gradient.
    """
    places = means.detach()
    away = places - eye.to(means.device, means.dtype, non_blocking=True)
    directions = away / away.norm(dim=1, keepdim=True).clamp_min(_LEAST_M)
    beside = [] if radius_m is None else [places / radius_m]
    one = codes.new_ones(len(codes), 1)
    width = codes.shape[1] + 4 + 3 * len(beside)
    filled = codes.new_zeros(len(codes), -width % _MULTIPLE)
    return torch.cat([codes, directions, *beside, one, filled], dim=1)


def visible_mask(viewpoint: Viewpoint, means: Tensor, reach_m: Tensor) -> Tensor:
    """Mark the points whose spheres may meet the view frustum; see `hybridworldsim.model.visible.select_visible`.

    Args:
        viewpoint: the camera.
        means: (N, 3).
        reach_m: (N,).

    Returns:
        (N,) bool.
    """
    view = torch.from_numpy(viewpoint.frustum).to(means.device, non_blocking=True).to(means.dtype)
    # Products as sums: a matrix product may compute in fewer bits on a GPU.
    places = (means.detach()[:, None] * view[:9].view(3, 3)).sum(2) + view[9:12]
    across, down, depth = places.unbind(1)
    low_x, high_x, low_y, high_y = view[13:17]
    reaches = reach_m[:, None] * view[17:21]
    return (
        (depth + reach_m > view[12])
        & (across + low_x * depth > -reaches[:, 0])
        & (high_x * depth - across > -reaches[:, 1])
        & (down + low_y * depth > -reaches[:, 2])
        & (high_y * depth - down > -reaches[:, 3])
    )


def blur(image: Tensor, window: Tensor) -> Tensor:
    """Convolve an image (H, W, C) with a window (odd,) along both axes; pixels beyond the border are black."""
    reach = len(window) // 2
    channels = image.permute(2, 0, 1)[:, None]
    down = functional.conv2d(channels, window[None, None, :, None], padding=(reach, 0))
    return functional.conv2d(down, window[None, None, None], padding=(0, reach))[:, 0].permute(1, 2, 0)
