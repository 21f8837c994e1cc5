"""A small street: points on a wall, a ground and a sky, with cameras and images rendered from its own Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.model.settings import Rate
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Source, Viewpoint
from mirror_baselines.splatting.settings import Densification, Splatting

WIDTH, HEIGHT = 48, 32
SOURCES = (Source("a", "front"), Source("b", "front"))


def initial(count: int = 120) -> InitialGeometry:
    rng = np.random.default_rng(3)
    points = rng.uniform((8.0, -6.0, 0.0), (9.0, 6.0, 4.0), (count, 3))
    driven = np.column_stack((np.linspace(0.0, 6.0, 7), np.zeros(7), np.zeros(7)))

    def ground(places):
        return np.zeros(len(places)), np.tile((0.0, 0.0, 1.0), (len(places), 1))

    far = rng.uniform((60.0, -30.0, 0.0), (70.0, 30.0, 9.0), (20, 3))
    return InitialGeometry(
        points, far, driven, ground, 30.0, SOURCES, rng.integers(0, 255, (count, 3)).astype(np.uint8)
    )


def small(settings: Splatting, **changes) -> Splatting:
    """The same method with few Gaussians and fast learning rates of colours."""
    seeding = replace(
        settings.seeding,
        most=100,
        spacing_m=0.2,
        ground_spacing_m=1.5,
        ground_reach_m=4.0,
        sky_count=min(settings.seeding.sky_count, 60),
        far_count=10,
    )
    quick = replace(settings.rates, sh0=Rate(3e-2, 3e-2), means=Rate(1e-2, 1e-3))
    return replace(settings, **{"seeding": seeding, "rates": quick, **changes})


def viewpoint(place: float = 0.0, source: Source = SOURCES[0]) -> Viewpoint:
    """A camera that looks along x from a height of 1.5 m; `place` metres forward and half as much to the left."""
    rotation = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ (place, 0.5 * place, 1.5)
    K = np.array([[40.0, 0.0, WIDTH / 2], [0.0, 40.0, HEIGHT / 2], [0.0, 0.0, 1.0]])
    return Viewpoint(WIDTH, HEIGHT, torch.from_numpy(K).float(), torch.from_numpy(viewmat).float(), source)


def image(rgb: torch.Tensor | float, at: Viewpoint | None = None, depth_m: float | None = 8.5) -> TrainingImage:
    at = viewpoint() if at is None else at
    pixels = rgb if isinstance(rgb, torch.Tensor) else torch.full((HEIGHT, WIDTH, 3), rgb)
    sky = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    sky[: HEIGHT // 4] = True
    depth = None if depth_m is None else torch.where(sky, 0.0, torch.full((HEIGHT, WIDTH), depth_m))
    return TrainingImage(at, pixels, torch.ones(HEIGHT, WIDTH, dtype=torch.bool), sky, depth)


def stripes(phase: float = 0.0) -> torch.Tensor:
    columns = (0.5 + 0.4 * torch.sin(torch.arange(WIDTH) * 0.9 + phase)).expand(HEIGHT, WIDTH)
    return torch.stack((columns, columns.flip(1), columns), 2)


def images(count: int = 6) -> list[TrainingImage]:
    """Images of both traversals in turn, from nearly equal places."""
    return [image(stripes(), viewpoint(0.02 * k, SOURCES[k % 2])) for k in range(count)]


GROWING = Densification(begin=0.05, end=0.9, rounds=6, resets=1, most=400, gradient=1e-6, split_m=0.3, largest_m=None)
