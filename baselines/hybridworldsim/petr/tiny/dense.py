"""The dense head: at each token the classes, the distance, the direction, the size and the heading of an object there.

Distances are predicted relative to the angle of a token, and headings relative to the ray, so that the same appearance
has the same output in every camera and wherever the vehicle looks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

_RARE = -math.log((1 - 0.02) / 0.02)
_GEOMETRY = 6
_BOX = 8
LOG_SIZE = (1.5, 0.6, 0.5)
"""Logarithms of a usual length, width and height, to which sizes are relative."""
_FAR = 5.0


@dataclass(frozen=True, eq=False)
class DenseOutput:
    """Outputs of the dense head; their leading axes index cells, such as (N, H, W) or (B, cells).

    Attributes:
        logits: (..., classes).
        log_distance: (...,) logarithm of the distance from the camera times the pitch.
        shift: (..., 2) to the left and up, from the ray to the direction of the middle of the object, in pitches.
        log_size: (..., 3) of length, width, height, relative to the usual ones.
        heading: (..., 2) sine and cosine of the yaw relative to the direction of the object; not normalised.
        direction: (..., 3) of the ray.
        origin: (..., 3) place of the camera.
        pitch: (...,) angle between neighbouring rays.
    """

    logits: Tensor
    log_distance: Tensor
    shift: Tensor
    log_size: Tensor
    heading: Tensor
    direction: Tensor
    origin: Tensor
    pitch: Tensor

    def of_frames(self, batch: int) -> DenseOutput:
        """Return the output with leading axes (B, N, H, W)."""
        return replace(self, **{name: value.unflatten(0, (batch, -1)) for name, value in vars(self).items()})

    def gather(self, cells: Tensor) -> DenseOutput:
        """Return the cells (B, P) of outputs (B, N, H, W)."""
        rows = torch.arange(cells.shape[0], device=cells.device)[:, None]
        return replace(self, **{name: value.flatten(1, 3)[rows, cells] for name, value in vars(self).items()})

    def peaks(self) -> Tensor:
        """Return the best logits (B, N, H, W) of cells, lowered by 100 where an adjacent cell has a higher one."""
        best = self.logits.amax(-1)
        around = nn.functional.max_pool2d(best.flatten(0, 1)[:, None], 3, 1, 1)[:, 0].unflatten(0, best.shape[:2])
        return torch.where(best >= around, best, best - 100.0)


@dataclass(frozen=True, eq=False)
class CellBoxes:
    """Boxes that cells of the dense head predict.

    Attributes:
        logits: (..., classes).
        code: (..., 10) as `hybridworldsim.petr.boxes.encode_boxes` with ``length-width``; velocities are 0.
    """

    logits: Tensor
    code: Tensor


def decode_cells(dense: DenseOutput) -> CellBoxes:
    """Return the boxes of cells."""
    azimuth, elevation = ray_angles(dense.direction)
    azimuth = azimuth + dense.shift[..., 0] * dense.pitch
    elevation = elevation + dense.shift[..., 1] * dense.pitch
    distance = (dense.log_distance - dense.pitch.log()).clamp(-1.0, _FAR).exp()
    flat = elevation.cos()
    toward = torch.stack((flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin()), -1)
    centre = dense.origin + distance[..., None] * toward
    yaw = torch.atan2(dense.heading[..., 0], dense.heading[..., 1]) + azimuth
    size = dense.log_size + dense.log_size.new_tensor(LOG_SIZE)
    angle = -yaw - 0.5 * math.pi
    code = (centre[..., :2], size[..., :2], centre[..., 2:], size[..., 2:], angle.sin()[..., None],
            angle.cos()[..., None], torch.zeros_like(centre[..., :2]))  # fmt: skip
    return CellBoxes(dense.logits, torch.cat(code, -1))


def ray_angles(direction: Tensor) -> tuple[Tensor, Tensor]:
    """Return the azimuth and elevation (...,) of unit vectors (..., 3)."""
    return torch.atan2(direction[..., 1], direction[..., 0]), direction[..., 2].clamp(-0.9999, 0.9999).asin()


def ray_pitch(directions: Tensor) -> Tensor:
    """Return the mean angle (N, H, W) between each ray (N, H, W, 3) and its horizontal neighbours."""
    step = (directions[:, :, 1:] - directions[:, :, :-1]).norm(dim=-1).clamp(1e-3, 1.0)
    padded = torch.cat((step[:, :, :1], step, step[:, :, -1:]), 2)
    return 0.5 * (padded[:, :, 1:] + padded[:, :, :-1])


class DenseHead(nn.Module):
    """A head that predicts cells from features and the geometry of their rays.

    Args:
        dim: channels of the features.
        classes: number of classes.
    """

    def __init__(self, dim: int, classes: int) -> None:
        super().__init__()
        self.classes = classes
        self.geometry = nn.Sequential(nn.Conv2d(_GEOMETRY, dim, 1), nn.ReLU(True), nn.Conv2d(dim, dim, 1))
        self.mix = nn.Sequential(nn.Conv2d(dim, dim, 3, padding=1, bias=False), nn.BatchNorm2d(dim), nn.ReLU(True))
        self.cells = nn.Sequential(nn.Conv2d(dim, dim, 3, padding=1, bias=False), nn.BatchNorm2d(dim), nn.ReLU(True))
        self.out = nn.Conv2d(dim, classes + _BOX, 1)
        with torch.no_grad():
            self.out.get_parameter("bias")[:classes] = _RARE

    def forward(self, features: Tensor, directions: Tensor, origins: Tensor) -> tuple[DenseOutput, Tensor]:
        """Return the outputs (N, H, W), and the features (N, C, H, W) mixed with the geometry of the rays.

        Args:
            features: (N, C, H, W).
            directions: (N, H, W, 3).
            origins: (N, 3).
        """
        pitch = ray_pitch(directions)
        mixed = self.mix(features + self.geometry(_geometry(directions, origins, pitch)))
        heat, box = self.out(self.cells(mixed)).permute(0, 2, 3, 1).split((self.classes, _BOX), -1)
        dense = DenseOutput(
            heat, box[..., 0], box[..., 1:3], box[..., 3:6], box[..., 6:8],
            directions, origins[:, None, None].expand_as(directions), pitch,
        )  # fmt: skip
        return dense, mixed


def _geometry(directions: Tensor, origins: Tensor, pitch: Tensor) -> Tensor:
    """(N, 6, H, W): what a ray says about distances, independent of the vehicle's heading."""
    up, height = directions[..., 2], origins[:, None, None, 2].expand_as(pitch)
    ground = (height.clamp(min=0.3) / (-up).clamp(min=0.01)).log()
    level = (1.0 - up * up).clamp(min=0.0).sqrt()
    return torch.stack((up, level, height - 1.5, pitch.log() + 3.0, ground - 2.5, ground + pitch.log()), 1)
