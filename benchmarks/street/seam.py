"""Measures the visibility of the boundary between two blocks: a step across it against a step inside a block."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from benchmarks.report import Peer, Row
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition
from hybridworldsim.model.parts import LatentSelector
from hybridworldsim.model.street import StreetModel
from mirror.arrays import Float64
from mirror.geometry.poses import Poses
from mirror.protocols.views.view import RenderView

STEP_M = 0.1


def seam_rows(
    blocks: Sequence[tuple[Block, StreetModel]],
    views: Sequence[RenderView],
    inside: Sequence[RenderView],
    select_latents: Callable[[RenderView], LatentSelector],
    name: str,
) -> list[Row]:
    """Return image changes for steps of cameras across the boundary of two blocks, and inside them.

    Args:
        blocks: two neighbours.
        views: views near their boundary; each is moved onto it.
        inside: views that show a single block; each makes the same step at its own place.
        select_latents: returns the latent selector of a view.
        name: name of the street.
    """
    (a, _), (b, _) = blocks
    way = np.array(b.origin_m[:2]) - np.array(a.origin_m[:2])
    way /= np.linalg.norm(way)
    middle = (np.array(a.origin_m[:2]) + np.array(b.origin_m[:2])) / 2.0
    street, alone = Composition(blocks), [Composition([one]) for one in blocks]

    def composed(view: RenderView) -> Tensor:
        return street.render(view, select_latents(view))[0].rgb.clamp(0.0, 1.0)

    def switched(view: RenderView) -> Tensor:
        beyond = float((view.pose.translation[0, :2] - middle) @ way) >= 0.0
        return alone[beyond].render(view, select_latents(view))[0].rgb.clamp(0.0, 1.0)

    def move_to_boundary(view: RenderView) -> float:
        return float((middle - view.pose.translation[0, :2]) @ way)

    def step_db(
        draw: Callable[[RenderView], Tensor], chosen: Sequence[RenderView], moved_m: Callable[[RenderView], float]
    ) -> float:
        errors = []
        for view in chosen:
            before, after = (draw(_moved(view, (moved_m(view) + side * STEP_M / 2.0) * way)) for side in (-1.0, 1.0))
            errors.append((after - before).square().mean())
        return float(-10.0 * torch.stack(errors).mean().clamp_min(1e-12).log10())

    size = f"{len(views)} views, steps of {STEP_M:g} m"
    peers = (Peer("one block at a time", step_db(switched, views, move_to_boundary)),)
    whole = torch.stack([(composed(view) - switched(view)).square().mean() for view in views]).mean()
    return [
        Row(f"{name}: dB PSNR of a step across", size, step_db(composed, views, move_to_boundary), peers=peers),
        Row(
            f"{name}: dB PSNR of a step inside",
            f"{len(inside)} views, the same",
            step_db(composed, inside, lambda _: 0.0),
        ),
        Row(
            f"{name}: dB PSNR, composed to the camera's own block", f"{len(views)} views", float(-10.0 * whole.log10())
        ),
    ]


def _moved(view: RenderView, by_m: Float64) -> RenderView:
    pose = view.pose
    moved = Poses(pose.rotation, pose.translation + np.array([[*by_m, 0.0]]))
    return view.model_copy(update={"world_SE3_camera": moved})
