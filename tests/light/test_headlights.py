from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from hybridworldsim.light.headlights import HeadlightField, add_light


def known_law(places: Tensor) -> Tensor:
    """A beam from (3.4, 0, 0.7) m, as strong as the square of the cosine about its axis."""
    rays = places - torch.tensor([3.4, 0.0, 0.7], dtype=places.dtype)
    distance = rays.norm(dim=1)
    ahead = (rays[:, 0] / distance).clamp_min(0.0)
    return 14.0 * ahead**8 / (4.0 + 0.09 * distance**2)


def fitted(seed: int = 0) -> HeadlightField:
    field, random = HeadlightField(seed), torch.Generator().manual_seed(1)
    adam = torch.optim.Adam(field.parameters(), lr=1e-2)
    for step in range(600):
        places = torch.rand(256, 3, generator=random) * torch.tensor([60.0, 24.0, 0.0]) - torch.tensor(
            [10.0, 12.0, 0.0]
        )
        error = (field(places, torch.eye(4), ground=True)[:, 0] - known_law(places)).square().mean()
        adam.zero_grad()
        error.backward()
        adam.param_groups[0]["lr"] = 1e-2 * 0.02 ** (step / 600)
        adam.step()
    return field


def test_a_field_learns_a_known_beam() -> None:
    field = fitted()
    x, y = torch.meshgrid(torch.linspace(6.0, 40.0, 12), torch.linspace(-6.0, 6.0, 9), indexing="ij")
    places = torch.stack([x.flatten(), y.flatten(), torch.zeros(x.numel())], dim=1)
    with torch.no_grad():
        light = field(places, torch.eye(4), ground=True)[:, 0]
        behind = field(torch.tensor([[-8.0, 0.0, 0.0]]), torch.eye(4), ground=True)[0, 0]
    truth = known_law(places)
    assert float(((light - truth).abs() / truth.max()).max()) < 0.08
    assert float((light - truth).abs().mean() / truth.mean()) < 0.1
    assert float(behind) < 0.02 * float(truth.max())


def test_the_field_moves_with_the_vehicle() -> None:
    field = HeadlightField(2)
    yaw = 0.7
    block_SE3_ego = torch.eye(4)
    block_SE3_ego[:2, :2] = torch.tensor([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    block_SE3_ego[:3, 3] = torch.tensor([30.0, -4.0, 0.5])
    ahead = torch.rand(50, 3) * 20.0
    moved = ahead @ block_SE3_ego[:3, :3].T + block_SE3_ego[:3, 3]
    with torch.no_grad():
        here, there = (
            field(ahead, torch.eye(4), ground=False),
            field(moved, torch.linalg.inv(block_SE3_ego), ground=False),
        )
    torch.testing.assert_close(here, there, rtol=1e-3, atol=1e-6)


def test_light_is_added_as_light_and_only_adds() -> None:
    colours, daylit = torch.rand(40, 3, dtype=torch.float64), torch.rand(40, 3, dtype=torch.float64)
    light = torch.rand(40, 3, dtype=torch.float64)
    expected = (colours.numpy() ** 2.2 + light.numpy() * daylit.numpy() ** 2.2) ** (1.0 / 2.2)
    np.testing.assert_allclose(add_light(colours, daylit, light).numpy(), expected, rtol=1e-3, atol=5e-3)
    assert (add_light(colours, daylit, light) >= colours).all()


def test_gradients_are_finite_where_all_is_dark() -> None:
    dark = torch.zeros(5, 3, requires_grad=True)
    light = torch.zeros(5, 3, requires_grad=True)
    add_light(dark, torch.ones(5, 3), light).sum().backward()
    assert dark.grad is not None and light.grad is not None
    assert dark.grad.isfinite().all() and light.grad.isfinite().all()


def test_a_place_in_a_lamp_is_finite() -> None:
    field = HeadlightField()
    places = field.lamps_m.detach()[None].clone()
    assert field(places, torch.eye(4), ground=True).isfinite().all()


@pytest.mark.parametrize("seed", [0, 1])
def test_untrained_headlights_are_nearly_dark(seed: int) -> None:
    with torch.no_grad():
        light = HeadlightField(seed)(torch.rand(100, 3) * 50.0, torch.eye(4), ground=True)
    assert float(light.max()) < 0.1
