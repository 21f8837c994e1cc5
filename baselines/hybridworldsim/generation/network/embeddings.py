"""Embeddings of positions, time steps, text and cameras, under the names of Stable Diffusion 3's state dict."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor, nn

_LONGEST: Final = 10_000.0
_STEP_CHANNELS: Final = 256


def encode_number(values: Tensor, channels: int) -> Tensor:
    """Encode numbers as cosines and sines of geometrically spaced frequencies (Vaswani et al., 2017).

    Args:
        values: (N,) numbers.
        channels: number of channels, even.

    Returns:
        (N, channels): all cosines, then all sines; float64 for float64, otherwise float32, as half precision does not
        hold the angles.
    """
    half = channels // 2
    dtype = torch.float64 if values.dtype == torch.float64 else torch.float32
    exponent = -math.log(_LONGEST) * torch.arange(half, dtype=dtype, device=values.device) / half
    angle = values[:, None].to(dtype) * exponent.exp()
    return torch.cat([angle.cos(), angle.sin()], dim=-1)


class NumberEmbedding(nn.Module):
    """A two-layer network on encoded numbers.

    Args:
        channels: channels of the input.
        hidden: channels of the first layer.
        out: channels of the result.
    """

    def __init__(self, channels: int, hidden: int, out: int) -> None:
        super().__init__()
        self.linear_1 = nn.Linear(channels, hidden)
        self.linear_2 = nn.Linear(hidden, out)

    def forward(self, encoded: Tensor) -> Tensor:
        """Map (..., channels) to (..., out)."""
        return self.linear_2(nn.functional.silu(self.linear_1(encoded)))


class StepTextEmbedding(nn.Module):
    """The embedding of time step and pooled text, which modulates the joint blocks.

    Args:
        width: channels of a token.
        pooled_channels: channels of the pooled text.
    """

    def __init__(self, width: int, pooled_channels: int) -> None:
        super().__init__()
        self.timestep_embedder = NumberEmbedding(_STEP_CHANNELS, width, width)
        self.text_embedder = NumberEmbedding(pooled_channels, width, width)

    def forward(self, timestep: Tensor, pooled: Tensor) -> Tensor:
        """Map time steps (N,) from 0 to 1000 and pooled texts (N, pooled_channels) to (N, width)."""
        encoded = encode_number(timestep, _STEP_CHANNELS).to(pooled.dtype)
        return self.timestep_embedder(encoded) + self.text_embedder(pooled)


def position_table(width: int, grid: int, base: int) -> Tensor:
    """Return the sines and cosines of the column and the row of each cell of a grid.

    Args:
        width: channels, a multiple of four.
        grid: side of the grid.
        base: positions are divided by ``grid / base``.

    Returns:
        (1, grid * grid, width), float32: half of the channels for the column, half for the row.
    """
    positions = torch.arange(grid, dtype=torch.float64) / (grid / base)
    quarter = width // 4
    omega = 1.0 / _LONGEST ** (torch.arange(quarter, dtype=torch.float64) / quarter)
    angle = positions[:, None] * omega
    line = torch.cat([angle.sin(), angle.cos()], dim=1).float()
    columns = line[None].expand(grid, grid, -1)
    rows = line[:, None].expand(grid, grid, -1)
    return torch.cat([columns, rows], dim=-1).reshape(1, grid * grid, width)


class PatchEmbedding(nn.Module):
    """A layer that maps latents to tokens and adds the position of each, from the middle of the table.

    Args:
        channels: channels of the latents.
        width: channels of a token.
        patch: latents per token, along a side.
        grid: side of the table of positions.
        base: see `position_table`.
    """

    pos_embed: Tensor

    def __init__(self, channels: int, width: int, patch: int, grid: int, base: int) -> None:
        super().__init__()
        self.grid = grid
        self.proj = nn.Conv2d(channels, width, kernel_size=patch, stride=patch)
        self.register_buffer("pos_embed", position_table(width, grid, base))

    def forward(self, latents: Tensor) -> Tensor:
        """Map (N, channels, H, W) to tokens (N, rows * columns, width), row by row."""
        tokens = self.proj(latents)
        rows, columns = tokens.shape[-2:]
        top, left = (self.grid - rows) // 2, (self.grid - columns) // 2
        table = self.pos_embed.view(self.grid, self.grid, -1)
        positions = table[top : top + rows, left : left + columns]
        return tokens.flatten(2).transpose(1, 2) + positions.reshape(1, rows * columns, -1).to(tokens.dtype)


class RayEncoder(nn.Module):
    """An encoder of one ray per token: sines and cosines of origin and direction, projected to the width of a token.

    Args:
        width: channels of a token.
        origin_octaves: octaves of the origin.
        direction_octaves: octaves of the direction.
    """

    def __init__(self, width: int, origin_octaves: int, direction_octaves: int) -> None:
        super().__init__()
        self.origin_octaves, self.direction_octaves = origin_octaves, direction_octaves
        self.proj = nn.Linear(6 * (origin_octaves + direction_octaves), width, bias=False)

    def forward(self, origin: Tensor, direction: Tensor) -> Tensor:
        """Map origins (N, 3), metres, and unit directions (N, L, 3) to (N, L, width)."""
        origins = _octaves(origin, self.origin_octaves)[:, None].expand(-1, direction.shape[1], -1)
        encoded = torch.cat([origins, _octaves(direction, self.direction_octaves)], dim=-1)
        return self.proj(encoded.to(self.proj.weight.dtype))


def _octaves(values: Tensor, octaves: int) -> Tensor:
    """(..., 3) to (..., 6 * octaves): all sines, then all cosines; each coordinate has its octaves side by side."""
    scales = math.pi * 2.0 ** torch.arange(octaves, dtype=values.dtype, device=values.device)
    angle = (values[..., None] * scales).flatten(-2)
    return torch.cat([angle.sin(), angle.cos()], dim=-1)


def token_rays(intrinsics: Tensor, camera_to_ego: Tensor, rows: int, columns: int) -> tuple[Tensor, Tensor]:
    """Return the rays through the centres of tokens.

    Args:
        intrinsics: (N, 3, 3) of images with sides of length 1: focal lengths and principal point as shares of the
            image's width and height.
        camera_to_ego: (N, 4, 4) ``ego_SE3_camera``, in the ego frame of the sequence's first frame.
        rows: rows of tokens.
        columns: columns of tokens.

    Returns:
        Origins (N, 3) in metres, and unit directions (N, rows * columns, 3).
    """
    u = (torch.arange(columns, dtype=intrinsics.dtype, device=intrinsics.device) + 0.5) / columns
    v = (torch.arange(rows, dtype=intrinsics.dtype, device=intrinsics.device) + 0.5) / rows
    grid = torch.stack([*torch.meshgrid(v, u, indexing="ij")][::-1], dim=-1).reshape(-1, 2)
    pixels = torch.cat([grid, torch.ones_like(grid[:, :1])], dim=-1)
    in_camera = pixels @ torch.linalg.inv(intrinsics).transpose(-1, -2)
    in_ego = in_camera @ camera_to_ego[:, :3, :3].transpose(-1, -2)
    return camera_to_ego[:, :3, 3], in_ego / in_ego.norm(dim=-1, keepdim=True)


def camera_numbers(rate_hz: Tensor, intrinsics: Tensor, camera_to_ego: Tensor, aspect: float) -> Tensor:
    """Return the numbers of the implicit camera condition, in OpenDWM's form.

    Args:
        rate_hz: (N,) frames per second.
        intrinsics: (N, 3, 3), as in `token_rays`.
        camera_to_ego: (N, 4, 4), in the ego frame of the same instant.
        aspect: width of the images divided by their height.

    Returns:
        (N, 11): rate; both focal lengths divided by the image's height; principal point as shares of width and height;
        forward axis and position of the camera in the ego frame.
    """
    # Both focal lengths are shares of the height: released weights were trained so.
    scale = torch.tensor([aspect, 1.0, 1.0, 1.0], dtype=intrinsics.dtype, device=intrinsics.device)
    lens = intrinsics[:, [0, 1, 0, 1], [0, 1, 2, 2]] * scale
    return torch.cat([rate_hz[:, None], lens, camera_to_ego[:, :3, 2], camera_to_ego[:, :3, 3]], dim=-1)
