"""Small streets with random parameters, and views of them."""

from __future__ import annotations

import numpy as np
import torch

from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, Seeds
from hybridworldsim.model.street import StreetModel
from hybridworldsim.trainable.viewpoint import Source
from mirror.protocols.views.view import RenderView

SOURCES = [Source("s.a.0", "front_wide"), Source("s.a.0", "rear")]
HALF = 30.0


def code_gaussians(means: torch.Tensor, size_m: float, seed: int, hidden: int = 12) -> CodeGaussians:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        count = len(means)
        node = CodeGaussians(
            Seeds(means, torch.randn(count, 4), size_m * (0.5 + torch.rand(count, 3)), 0.9), 16, 8, hidden
        )
        node.codes.data = 3.0 * torch.randn(count, 16)
        node.logits.data += torch.randn(count)
        return node


def street(anchors: int = 300, seed: int = 0, k: int = 10, hidden: int = 12) -> StreetModel:
    """Anchors in a box of 60 m, a ground below them and a sky around; the networks do not depend on the place."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        box = torch.tensor((2.0 * HALF, 2.0 * HALF, 10.0))
        background = Anchors(
            (torch.rand(anchors, 3) - torch.tensor((0.5, 0.5, 0.0))) * box,
            0.2 + torch.rand(anchors),
            75.0,
            offsets=k,
            code=32,
            latent=8,
            hidden=hidden,
        )
        background.codes.data = 2.0 * torch.randn(anchors, 32)
        flat = (torch.rand(400, 3) - 0.5) * torch.tensor((2.0 * HALF, 2.0 * HALF, 0.0))
        around = torch.nn.functional.normalize(torch.randn(200, 3), dim=1)
        around[:, 2] = around[:, 2].abs()
        for network in (background.geometry, background.colour):
            network.own.data[:, -3:] = 0.0
        return StreetModel(
            background,
            code_gaussians(flat, 1.5, seed + 1, hidden),
            code_gaussians(300.0 * around, 30.0, seed + 2, hidden),
            AppearanceLatents(SOURCES, 8),
        )


def view(
    x_m: float = 0.0, y_m: float = 0.0, z_m: float = 1.5, camera: str = "front_wide", fx_px: float = 40.0
) -> RenderView:
    """A camera that looks along the world's x axis."""
    return RenderView(
        path=f"renders/test/s.a.0/{camera}/0.png",
        group="test",
        scene_id="s",
        traversal_id="s.a.0",
        frame_index=0,
        camera=camera,
        timestamp_ns=0,
        light="day",
        weather="clear",
        model="pinhole",
        width_px=96,
        height_px=54,
        fx_px=fx_px,
        fy_px=fx_px,
        cx_px=48.0,
        cy_px=27.0,
        distortion=(),
        world_SE3_camera=(0.5, -0.5, 0.5, -0.5, x_m, y_m, z_m),
    )


def shifted(one: StreetModel, by: np.ndarray, seed: int = 0) -> StreetModel:
    """The same street in a frame with another origin."""
    other = street(len(one.background), seed, one.background.k)
    other.load_state_dict(one.state_dict())
    for node in (other.background, other.ground, other.sky):
        node.means.data += torch.tensor(by, dtype=torch.float32)
    return other
