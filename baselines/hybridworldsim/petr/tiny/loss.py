"""The losses of the tiny network: those of PETR for the decoder, and heat, distance, angles and size at cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from hybridworldsim.petr.boxes import encode_boxes
from hybridworldsim.petr.head import HeadOutput
from hybridworldsim.petr.loss import TrueBoxes, detection_loss
from hybridworldsim.petr.tiny.dense import LOG_SIZE, DenseOutput, ray_angles
from hybridworldsim.petr.tiny.settings import CLASSES

_LEAST_HEAT = 0.3
_CODE_WEIGHTS = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class BatchBoxes:
    """True boxes of the frames of a batch, all in one list of K.

    Attributes:
        frame: (K,) number of the frame in the batch.
        label: (K,).
        centre: (K, 3).
        size: (K, 3).
        yaw: (K,).
        cell: (K, N, 2).
        spread: (K, N).
    """

    frame: Tensor
    label: Tensor
    centre: Tensor
    size: Tensor
    yaw: Tensor
    cell: Tensor
    spread: Tensor


def tiny_loss(output: HeadOutput, dense: DenseOutput, truth: BatchBoxes) -> dict[str, Tensor]:
    """Return all losses by name, weighted."""
    batch = output.logits.shape[1]
    weights = output.codes.new_tensor(_CODE_WEIGHTS)
    decoder = detection_loss(output, _true_boxes(truth, batch), weights)
    return {**decoder, **dense_loss(dense, truth)}


def _true_boxes(truth: BatchBoxes, batch: int) -> Sequence[TrueBoxes]:
    velocity = truth.centre.new_zeros(len(truth.label), 2)
    code = encode_boxes(truth.centre, truth.size, truth.yaw, velocity, "length-width")
    return [TrueBoxes(truth.label[truth.frame == one], code[truth.frame == one]) for one in range(batch)]


def dense_loss(dense: DenseOutput, truth: BatchBoxes) -> dict[str, Tensor]:
    """Return the losses of the dense head, (B, N, H, W)."""
    batch, cameras, height, width = dense.pitch.shape
    box, camera = torch.nonzero(~truth.cell[..., 0].isnan(), as_tuple=True)
    image = truth.frame[box] * cameras + camera
    column, row = truth.cell[box, camera].unbind(-1)
    spread = truth.spread[box, camera]
    x = torch.arange(width, dtype=spread.dtype) + 0.5
    y = torch.arange(height, dtype=spread.dtype) + 0.5
    away = (x[None, None] - column[:, None, None]) ** 2 + (y[None, :, None] - row[:, None, None]) ** 2
    heat = torch.exp(-0.5 * away / spread[:, None, None] ** 2)
    entry = torch.arange(len(box))
    heat[entry, row.long(), column.long()] = 1.0
    heat = heat.flatten(1)

    cells = height * width
    target = heat.new_zeros(batch * cameras * len(CLASSES) * cells)
    place = ((image * len(CLASSES) + truth.label[box]) * cells)[:, None] + torch.arange(cells)
    target.scatter_reduce_(0, place.flatten(), heat.flatten(), "amax")
    target = target.view(batch, cameras, len(CLASSES), height, width).permute(0, 1, 3, 4, 2)
    p = dense.logits.sigmoid().clamp(1e-4, 1.0 - 1e-4)
    positive = -((1.0 - p) ** 2) * p.log() * (target == 1.0)
    negative = -((1.0 - target) ** 4) * p**2 * (1.0 - p).log() * (target < 1.0)
    count = max(len(box), 1)
    losses = {"heat": (positive + negative).sum() / count}

    # A cell belongs to the box with the most heat there.
    best = heat.new_zeros(batch * cameras * cells)
    place = (image * cells)[:, None] + torch.arange(cells)
    best.scatter_reduce_(0, place.flatten(), heat.flatten(), "amax")
    entry, cell = torch.nonzero((heat >= best[place]) & (heat > _LEAST_HEAT), as_tuple=True)
    weight = heat[entry, cell]
    box, index = box[entry], place[entry, cell]

    def at(values: Tensor) -> Tensor:
        return values.flatten(0, 3)[index]

    pitch = at(dense.pitch)
    offset = truth.centre[box] - at(dense.origin)
    distance = offset.norm(dim=-1).clamp(min=0.1)
    azimuth, elevation = ray_angles(offset / distance[:, None])
    ray_azimuth, ray_elevation = ray_angles(at(dense.direction))
    turn = torch.remainder(azimuth - ray_azimuth + torch.pi, 2.0 * torch.pi) - torch.pi
    shift = torch.stack((turn, elevation - ray_elevation), -1) / pitch[:, None]
    yaw = truth.yaw[box] - azimuth
    heading = torch.stack((yaw.sin(), yaw.cos()), -1)
    size = truth.size[box].log() - weight.new_tensor(LOG_SIZE)
    total = weight.sum().clamp(min=1.0)
    for name, scale, found, true in (
        ("distance", 2.0, at(dense.log_distance)[:, None], (distance * pitch).log()[:, None]),
        ("angles", 0.2, at(dense.shift), shift.clamp(-8.0, 8.0)),
        ("size", 0.5, at(dense.log_size), size),
        ("heading", 0.5, at(dense.heading), heading),
    ):
        losses[name] = (
            scale * (F.smooth_l1_loss(found, true, reduction="none", beta=0.1).sum(-1) * weight).sum() / total
        )
    return losses
