"""Composition of agents in plain torch, on any device; `compositing` beside it has the compiled kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from hybridworldsim.simulator.renderers.compositing import (
    CELL_M,
    FADE_M,
    FARTHEST_M,
    HEIGHT_M,
    HIDDEN,
    NEAREST_M,
    REACH_M,
    SHADE,
    shadow_bounds,
)
from mirror.arrays import Float64


@dataclass(frozen=True, eq=False)
class AgentTensors:
    """The agents alone in one camera; see `hybridworldsim.simulator.renderers.agent_layer.AgentImage`.

    Attributes:
        rgb: (H, W, 3) uint8.
        alpha: (H, W).
        limit_m: (H, W) camera z in front of which the street hides them.
    """

    rgb: Tensor
    alpha: Tensor
    limit_m: Tensor


def compose(
    rgb: Tensor,
    depth_m: Tensor,
    covered: Tensor,
    agents: AgentTensors,
    lens: Float64,
    rotation: Float64,
    origin: Float64,
    is_free: Tensor,
    free_origin: Float64,
) -> tuple[Tensor, Tensor]:
    """Put agents into an image, and return it with where it shows an agent; see `compositing.compose`."""
    place = _Places(depth_m, lens, rotation, origin, 0, 0)
    x, y, _ = place.in_world()
    row, column = ((y - free_origin[1]) / CELL_M).long(), ((x - free_origin[0]) / CELL_M).long()
    rows, columns = is_free.shape
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    on_road = inside & is_free.reshape(-1)[row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)]
    # Most of the pixel is covered before the agent; the mean depth may lie behind it.
    hidden = (covered > HIDDEN) & (depth_m > NEAREST_M) & ((depth_m >= agents.limit_m) | ~on_road)
    drawn = (agents.alpha > 0.0) & ~hidden
    share = agents.alpha.double()[..., None]
    mixed = (share * agents.rgb + (1.0 - share) * rgb + 0.5).clamp_max(255.0).to(torch.uint8)
    return torch.where(drawn[..., None], mixed, rgb), drawn & (agents.alpha >= 0.5)


def add_contact_shadows(
    rgb: Tensor, depth_m: Tensor, lens: Float64, rotation: Float64, origin: Float64, boxes: Float64
) -> None:
    """Darken the ground under agents in an image (H, W, 3), uint8; see `compositing.add_contact_shadows`."""
    height, width = depth_m.shape
    for x, y, z, yaw, half_length, half_width in boxes.tolist():
        if math.hypot(x - origin[0], y - origin[1]) > FARTHEST_M:
            continue
        cos, sin = math.cos(yaw), math.sin(yaw)
        reaches = half_length + REACH_M, half_width + REACH_M
        left, top, right, bottom = shadow_bounds(x, y, z, cos, sin, *reaches, lens, rotation, origin, width, height)
        if left >= right or top >= bottom:
            continue
        part = depth_m[top:bottom, left:right]
        dx, dy, dz = _Places(part, lens, rotation, origin - (x, y, z), left, top).in_world()
        along = ((cos * dx + sin * dy).abs() - half_length + 0.1).clamp_min(0.0)
        aside = ((cos * dy - sin * dx).abs() - half_width + 0.1).clamp_min(0.0)
        beyond, above = torch.hypot(along, aside), dz.abs()
        light = 1.0 - SHADE * torch.exp(-beyond / FADE_M) * (1.0 - above / HEIGHT_M)
        shaded = (part > 0.0) & (above <= HEIGHT_M) & (beyond <= REACH_M)
        own = rgb[top:bottom, left:right]
        darker = (own * light[..., None]).to(torch.uint8)
        own.copy_(torch.where(shaded[..., None], darker, own))


@dataclass(frozen=True, eq=False)
class _Places:
    """The places that the pixels of a part of a depth map show."""

    depth_m: Tensor
    lens: Float64
    rotation: Float64
    origin: Float64
    left: int
    top: int

    def in_world(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, y and z (H, W), float64, in the world less `origin`'s shift."""
        rows, columns = self.depth_m.shape
        device, far = self.depth_m.device, self.depth_m.double()
        fx, fy, cx, cy = self.lens.tolist()
        u = torch.arange(self.left, self.left + columns, dtype=torch.float64, device=device) + 0.5
        v = torch.arange(self.top, self.top + rows, dtype=torch.float64, device=device)[:, None] + 0.5
        a, b = (u - cx) / fx * far, (v - cy) / fy * far
        x, y, z = (
            one * a + two * b + three * far + start
            for (one, two, three), start in zip(self.rotation.tolist(), self.origin.tolist(), strict=True)
        )
        return x, y, z
