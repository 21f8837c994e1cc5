"""Boxes and their codes, in both generations of published checkpoints; decoding without suppression of neighbours.

A code is ``x y a b z log-height sin cos vx vy``. Up to mmdetection3d 0.17, a and b are the logarithms of width and
length, and the angle is the old yaw; from 1.0 on they are those of length and width, and the angle is -yaw - pi / 2,
which equals the old yaw. So the direction of the heading agrees, and only width and length are exchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from hybridworldsim.petr.head import HeadOutput

Generation = Literal["width-length", "length-width"]


@dataclass(frozen=True, eq=False)
class DecodedBoxes:
    """K boxes in the network's frame, by falling score.

    Attributes:
        centre_m: (K, 3) middle of the box.
        size_m: (K, 3) length, width, height.
        yaw_rad: (K,) heading about z, from x.
        velocity_mps: (K, 2).
        label: (K,) number of the class.
        score: (K,).
    """

    centre_m: Tensor
    size_m: Tensor
    yaw_rad: Tensor
    velocity_mps: Tensor
    label: Tensor
    score: Tensor


def encode_boxes(centre: Tensor, size: Tensor, yaw: Tensor, velocity: Tensor, generation: Generation) -> Tensor:
    """Return the codes (K, 10) of boxes: centres (K, 3), length, width, height (K, 3), yaws (K,), velocities (K, 2)."""
    log = size.log()
    pair = log[:, [1, 0]] if generation == "width-length" else log[:, [0, 1]]
    angle = (-yaw - 0.5 * math.pi)[:, None]
    return torch.cat((centre[:, :2], pair, centre[:, 2:], log[:, 2:], angle.sin(), angle.cos(), velocity), 1)


def decode_boxes(
    output: HeadOutput,
    generation: Generation,
    *,
    most: int = 300,
    min_score: float = 0.0,
    centre_range_m: tuple[float, ...] = (-61.2, -61.2, -10.0, 61.2, 61.2, 10.0),
) -> list[DecodedBoxes]:
    """Return the best boxes of the last layer: each pair of query and class is one candidate.

    Args:
        output: outputs of the head.
        generation: order of width and length.
        most: greatest number of boxes of an image set.
        min_score: boxes with a lower score are left out.
        centre_range_m: boxes with centres outside are left out.

    Returns:
        The boxes of each of the B image sets.
    """
    found = []
    low, high = torch.tensor(centre_range_m[:3]), torch.tensor(centre_range_m[3:])
    for logits, codes in zip(output.logits[-1], output.codes[-1]):
        scores = logits.sigmoid().flatten()
        score, index = scores.topk(min(most, len(scores)))
        label, code = index % logits.shape[-1], codes[index // logits.shape[-1]]
        centre = code[:, [0, 1, 4]]
        inside = ((centre >= low.to(centre)) & (centre <= high.to(centre))).all(1) & (score >= min_score)
        code, centre = code[inside], centre[inside]
        pair = code[:, [3, 2]] if generation == "width-length" else code[:, [2, 3]]
        size = torch.cat((pair, code[:, 5:6]), 1).exp()
        angle = torch.atan2(code[:, 6], code[:, 7])
        yaw = torch.remainder(-angle - 0.5 * math.pi + math.pi, 2.0 * math.pi) - math.pi
        found.append(DecodedBoxes(centre, size, yaw, code[:, 8:10], label[inside], score[inside]))
    return found
