"""What the policies perceive: offset from the lane, heading against it, distance of the lead; exactly, or by a network.

Heading is that of the lane a little ahead, so that a bend needs no fourth number.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import nn

from hybridworldsim.simulator.agents.corridor import gap_on_way
from hybridworldsim.simulator.ego.vehicle import EgoState, VehicleParameters
from mirror.arrays import Float64, UInt8
from mirror.traffic.lanes.ways import STEP_M

_MARGIN_M: Final = 0.15
OFFSET_M: Final = 0.5
HEADING_RAD: Final = 0.1


@dataclass(frozen=True)
class Percept:
    """The offset in the lane, the heading and the lead that one image shows.

    Attributes:
        offset_m: place of the rear axle to the left of the lane's middle.
        heading_rad: direction of the lane ahead, to the left of the vehicle's.
        lead_m: gap between the vehicle's front and the next road user in the lane; at most the sight.
    """

    offset_m: float
    heading_rad: float
    lead_m: float


def perceive_exactly(
    route_m: Float64, ego: EgoState, boxes: Float64, vehicle: VehicleParameters, lookahead_m: float, sight_m: float
) -> Percept:
    """Return the percept of the exact state.

    Args:
        route_m: (K, 2) points of the lane's middle in the world, every half metre.
        ego: the ego in the world.
        boxes: (M, 7) boxes as `PrivilegedState` has them; the ego is the first.
        vehicle: the ego vehicle.
        lookahead_m: how far ahead the heading of the lane is taken.
        sight_m: the greatest distance of a lead.
    """
    nearest = int(np.argmin(((route_m - (ego.x_m, ego.y_m)) ** 2).sum(axis=1)))
    here, ahead = (
        _direction(route_m, min(nearest + steps, len(route_m) - 1)) for steps in (0, round(lookahead_m / STEP_M))
    )
    dx, dy = ego.x_m - route_m[nearest, 0], ego.y_m - route_m[nearest, 1]
    offset = -math.sin(here) * dx + math.cos(here) * dy
    front = vehicle.rear_axle_to_center_m + 0.5 * vehicle.length_m
    at, lead = STEP_M * nearest + front, sight_m
    for box in boxes[1:]:
        if box[6]:
            gap, _ = gap_on_way(
                route_m, 0, len(route_m) - 1, at, front, 0.0, 0.5 * vehicle.width_m + _MARGIN_M, sight_m, box
            )
            lead = min(lead, gap)
    return Percept(float(offset), math.remainder(ahead - ego.yaw_rad, 2.0 * math.pi), max(lead, 0.0))


def _direction(route_m: Float64, index: int) -> float:
    low, high = max(index - 1, 0), min(index + 1, len(route_m) - 1)
    return math.atan2(*(route_m[high] - route_m[low])[::-1])


class PerceptionNet(nn.Module):
    """A small convolutional network: an image of 160 x 90 pixels to three numbers, each of about unit scale."""

    def __init__(self) -> None:
        super().__init__()
        sizes = (3, 16, 32, 48, 64)
        layers: list[nn.Module] = []
        for place, (inner, outer) in enumerate(itertools.pairwise(sizes)):
            layers += [nn.Conv2d(inner, outer, 5 if place == 0 else 3, 2, 1), nn.ReLU(inplace=True)]
        # 160 x 90 pixels become a map of this size; it lets tests take smaller images.
        rows, columns = 6, 10
        self.features = nn.Sequential(*layers, nn.AdaptiveAvgPool2d((rows, columns)), nn.Flatten())
        self.head = nn.Sequential(nn.Linear(sizes[-1] * rows * columns, 64), nn.ReLU(inplace=True), nn.Linear(64, 3))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return scaled percepts (N, 3) of images (N, 3, H, W) between 0 and 1."""
        found: torch.Tensor = self.head(self.features(2.0 * images - 1.0))
        return found


def scale(percepts: Float64, sight_m: float) -> Float64:
    """Scale percepts (N, 3) to about unit scale; near leads count more than far ones."""
    lead = np.log1p(np.clip(percepts[:, 2], 0.0, sight_m)) / math.log1p(sight_m)
    return np.column_stack([percepts[:, 0] / OFFSET_M, percepts[:, 1] / HEADING_RAD, 2.0 * lead])


def unscale(numbers: Float64, sight_m: float) -> Float64:
    """Return the inverse of `scale`."""
    lead = np.expm1(np.clip(0.5 * numbers[:, 2], 0.0, 1.0) * math.log1p(sight_m))
    return np.column_stack([numbers[:, 0] * OFFSET_M, numbers[:, 1] * HEADING_RAD, lead])


def to_tensor(images: UInt8) -> torch.Tensor:
    """Return the images (N, H, W, 3) as (N, 3, H, W) float32 between 0 and 1."""
    return torch.from_numpy(np.ascontiguousarray(images)).permute(0, 3, 1, 2).float().div_(255.0)


def perceive(network: PerceptionNet, images: UInt8, sight_m: float) -> Float64:
    """Return percepts (N, 3) of images (N, H, W, 3)."""
    with torch.inference_mode():
        return unscale(network(to_tensor(images)).double().numpy(), sight_m)
