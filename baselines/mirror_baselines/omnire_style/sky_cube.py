"""The sky as a cube of images at infinity."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from hybridworldsim.trainable.viewpoint import Viewpoint

_GREY = 0.5


class SkyCube(nn.Module):
    """A sky of six faces, sampled by direction.

    Args:
        size_px: width of a face.
    """

    def __init__(self, size_px: int) -> None:
        super().__init__()
        # The faces lie side by side, so that one lookup samples all six.
        self.faces = nn.Parameter(torch.full((1, 3, size_px, 6 * size_px), _GREY))

    def forward(self, viewpoint: Viewpoint) -> Tensor:
        """Return the sky (H, W, 3) of a viewpoint, whatever its position."""
        return self.sample(ray_directions(viewpoint, self.faces.device))

    def sample(self, rays: Tensor) -> Tensor:
        """Return the sky (H, W, 3) in directions (H, W, 3) of any length."""
        size = self.faces.shape[2]
        longest, axis = rays.abs().max(-1)
        along = rays.gather(-1, axis[..., None])[..., 0]
        face = 2 * axis + (along < 0.0)
        across, up = (rays.gather(-1, ((axis + step) % 3)[..., None])[..., 0] / longest for step in (1, 2))
        # Clamp to the centres of a face's outermost pixels: beyond them lies another face.
        inner = 1.0 - 1.0 / size
        places = torch.stack(
            ((2.0 * face + 1.0 + across.clamp(-inner, inner)) / 6.0 - 1.0, up.clamp(-inner, inner)), -1
        )
        sampled = functional.grid_sample(self.faces, places[None], mode="bilinear", align_corners=False)
        return sampled[0].permute(1, 2, 0)


def ray_directions(viewpoint: Viewpoint, device: torch.device | None = None) -> Tensor:
    """Return the directions (H, W, 3) of the pixels' rays in the block's frame, of any length.

    Args:
        viewpoint: the camera.
        device: where they are computed; None: on the CPU.
    """
    K, viewmat = viewpoint.K, viewpoint.viewmat
    viewmat = viewmat if device is None else viewmat.to(device, non_blocking=True)
    x = (torch.arange(viewpoint.width_px, device=device) + 0.5 - K[0, 2]) / K[0, 0]
    y = (torch.arange(viewpoint.height_px, device=device) + 0.5 - K[1, 2]) / K[1, 1]
    right, down, forward = viewmat[:3, :3]
    return x[None, :, None] * right + y[:, None, None] * down + forward
