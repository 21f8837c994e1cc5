"""The light that the vehicle itself throws on the street: a smooth field in the vehicle's frame."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

GAMMA: Final = 2.2
"""Colours of Gaussians are added as light: to this power."""

_LAMPS_M: Final = (3.0, 0.0, 0.7)
_SOFT_M: Final = 7.0
_HIDDEN: Final = 16
_DARK: Final = -4.0
_DARKEST: Final = 1e-5
_LEAST_M: Final = 0.5
_DISTANCE_UNIT: Final = 2.0


class HeadlightField(nn.Module):
    """The light (three colours, 0 or more) that headlights throw on a place, relative to daylight on it.

    A small network reads the direction (azimuth and elevation from the lamps), the logarithm of the distance, and
    whether the place lies on the ground, which light grazes. Its output falls with the square of the distance. A
    hundred and fifty numbers describe all vehicles of one type; the field moves with the vehicle.

    Args:
        seed: seed of the first numbers.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.lamps_m = nn.Parameter(torch.tensor(_LAMPS_M))
            self.hidden = nn.Linear(5, _HIDDEN)
            self.out = nn.Linear(_HIDDEN, 3)
        with torch.no_grad():
            # Begin nearly dark: images without headlights keep their colours.
            self.out.bias.fill_(_DARK)

    def forward(self, places_m: Tensor, ego_SE3_block: Tensor, *, ground: bool) -> Tensor:
        """Return the light (N, 3) at places.

        Args:
            places_m: (N, 3) in the block's frame, metres.
            ego_SE3_block: (4, 4) from the block's frame to the vehicle's (x ahead, y to the left, z up).
            ground: whether the places lie on the ground.
        """
        rays = places_m @ ego_SE3_block[:3, :3].T + (ego_SE3_block[:3, 3] - self.lamps_m)
        distance = rays.norm(dim=1, keepdim=True).clamp_min(_LEAST_M)
        unit = rays / distance
        beyond = (distance / _SOFT_M).log() / _DISTANCE_UNIT
        inputs = torch.cat([unit, beyond, torch.full_like(beyond, float(ground))], dim=1)
        shape = functional.softplus(self.out(torch.tanh(self.hidden(inputs))))
        return shape / (1.0 + (distance / _SOFT_M).square())


def add_light(colours: Tensor, daylit: Tensor, light: Tensor) -> Tensor:
    """Return colours (N, 3) under additional light.

    Args:
        colours: (N, 3) colours without it.
        daylit: (N, 3) colours by day, which stand for the reflectance.
        light: (N, 3) the light, relative to daylight.
    """
    total = colours.clamp_min(_DARKEST).pow(GAMMA) + light * daylit.clamp_min(_DARKEST).pow(GAMMA)
    return total.pow(1.0 / GAMMA)
