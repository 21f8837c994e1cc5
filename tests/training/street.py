"""A tiny street for tests of training: a wall and a road, in analytic images of two traversals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hybridworldsim.model.initialization import InitialGeometry, initial_street
from hybridworldsim.model.settings import AnchorRefinement, Settings
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Source, Viewpoint, to_viewpoint
from mirror.protocols.views.view import RenderView, to_pose

WIDTH, HEIGHT = 32, 20
TRAVERSALS = ("s.day.0", "s.night.0")
SETTINGS = Settings(
    first_anchors=300,
    ground_spacing_m=2.0,
    ground_reach_m=6.0,
    sky_count=60,
    far_count=50,
    hidden=8,
    offsets=4,
    refinement=AnchorRefinement(begin=0.2, end=0.9, times=3, max_anchors=400),
)


def view(traversal: str, frame: int, camera: str = "front_wide", x_m: float | None = None) -> RenderView:
    """A camera 1.5 m above the road that looks along x."""
    return RenderView(
        path=f"renders/training/{traversal}/{camera}/{frame}.png",
        group="training",
        scene_id="s",
        traversal_id=traversal,
        frame_index=frame,
        camera=camera,
        timestamp_ns=frame,
        light="night" if "night" in traversal else "day",
        weather="clear",
        model="pinhole",
        width_px=WIDTH,
        height_px=HEIGHT,
        fx_px=20.0,
        fy_px=20.0,
        cx_px=WIDTH / 2,
        cy_px=HEIGHT / 2,
        distortion=(),
        # Camera z along the world's x, camera x along minus y, camera y down.
        world_SE3_camera=to_pose((0.5, -0.5, 0.5, -0.5, 1.0 * frame if x_m is None else x_m, 0.0, 1.5)),
    )


def views(count: int = 6, traversals: Sequence[str] = TRAVERSALS) -> list[RenderView]:
    return [view(traversal, frame) for traversal in traversals for frame in range(count)]


def initial(sources: Sequence[Source] | None = None) -> InitialGeometry:
    """Points on a wall at x = 20 m and a flat road."""
    y, z = np.meshgrid(np.linspace(-8, 8, 20), np.linspace(0, 6, 10))
    wall = np.column_stack((np.full(y.size, 20.0), y.ravel(), z.ravel()))
    driven = np.column_stack((np.arange(10.0), np.zeros(10), np.zeros(10)))

    def ground(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(len(places)), np.tile((0.0, 0.0, 1.0), (len(places), 1))

    sources = sources or [Source(name, "front_wide") for name in TRAVERSALS]
    return InitialGeometry(wall, np.array([[90.0, 0.0, 5.0]]), driven, ground, 30.0, sources)


def trainer(settings: Settings = SETTINGS) -> StreetTrainer:
    return StreetTrainer(initial_street(initial(), settings), settings)


def render_image(viewpoint: Viewpoint, night: bool) -> TrainingImage:
    """Compute an image from the ray of each pixel: stripes on the wall, a grey road, a sky."""
    v, u = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
    across, down = (u - WIDTH / 2) / 20.0, (v - HEIGHT / 2) / 20.0
    ahead = 20.0 - float(viewpoint.centre[0])
    y, z = -across * ahead, 1.5 - down * ahead
    wall = torch.stack((0.5 + 0.4 * torch.sin(y), 0.3 + 0.05 * z, 0.4 + 0.0 * y), dim=-1)
    rgb = torch.where((z > 6.0)[..., None], torch.tensor([0.5, 0.7, 0.9]), wall)
    rgb = torch.where((z < 0.0)[..., None], torch.tensor([0.35, 0.35, 0.35]), rgb)
    depth = torch.where(z < 0.0, 1.5 / down.clamp_min(1e-3), torch.where(z > 6.0, 0.0, ahead))
    rgb = (rgb * (0.3 if night else 1.0)).clamp(0.0, 1.0)
    return TrainingImage(viewpoint, rgb, torch.ones(HEIGHT, WIDTH, dtype=torch.bool), z > 6.0, depth)


Edit = Callable[[TrainingImage], TrainingImage]


@dataclass
class Painted:
    """Opens images as `hybridworldsim.training.data_loader.TrainingImageCache` does, without a dataset."""

    edit: Edit = lambda image: image
    opened: int = 0

    def __call__(self, one: RenderView) -> TrainingImage:
        self.opened += 1
        image = render_image(to_viewpoint(one, np.zeros(3)), "night" in one.traversal_id)
        return replace(self.edit(image), name=one.path)
