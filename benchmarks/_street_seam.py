"""What is seen of the boundary between two blocks: a step across it against the same step inside a block."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from benchmarks.report import Peer, Row
from hybridworldsim.rendering.composition import Composition
from hybridworldsim.rendering.parts import Looks
from hybridworldsim.scene.blocks import Block
from hybridworldsim.scene.street import Street
from mirror.arrays import Float64
from mirror.evaluation.views.view import View, pose_numbers
from mirror.geometry.poses import Poses

STEP_M = 0.1


def seam_rows(
    blocks: Sequence[tuple[Block, Street]], views: Sequence[View], looks: Callable[[View], Looks], name: str
) -> list[Row]:
    """Steps of cameras across the boundary of two blocks, and inside them.

    Args:
        blocks: two neighbours.
        views: near their boundary; each is moved onto it.
        looks: of a view, the appearance.
        name: of the street.
    """
    (a, _), (b, _) = blocks
    way = np.array(b.origin_m[:2]) - np.array(a.origin_m[:2])
    way /= np.linalg.norm(way)
    middle = (np.array(a.origin_m[:2]) + np.array(b.origin_m[:2])) / 2.0
    street, alone = Composition(blocks), [Composition([one]) for one in blocks]

    def composed(view: View) -> Tensor:
        return street.draw(view, looks(view))[0].rgb.clamp(0.0, 1.0)

    def switched(view: View) -> Tensor:
        beyond = float((view.pose.translation[0, :2] - middle) @ way) >= 0.0
        return alone[beyond].draw(view, looks(view))[0].rgb.clamp(0.0, 1.0)

    def step_db(draw: Callable[[View], Tensor], offset_m: float) -> float:
        errors = []
        for view in views:
            onto = float((middle - view.pose.translation[0, :2]) @ way) + offset_m
            before, after = (draw(_moved(view, (onto + side * STEP_M / 2.0) * way)) for side in (-1.0, 1.0))
            errors.append((after - before).square().mean())
        return float(-10.0 * torch.stack(errors).mean().clamp_min(1e-12).log10())

    # Beyond the strip that both show, on either side.
    inside = min(step_db(composed, side * a.overlap_m) for side in (-1.0, 1.0))
    size = f"{len(views)} views, steps of {STEP_M:g} m"
    peers = (Peer("one block at a time", step_db(switched, 0.0)),)
    whole = torch.stack([(composed(view) - switched(view)).square().mean() for view in views]).mean()
    return [
        Row(f"{name}: dB PSNR of a step across", size, step_db(composed, 0.0), peers=peers),
        Row(f"{name}: dB PSNR of a step inside", size, inside),
        Row(
            f"{name}: dB PSNR, composed to the camera's own block", f"{len(views)} views", float(-10.0 * whole.log10())
        ),
    ]


def _moved(view: View, by_m: Float64) -> View:
    pose = view.pose
    moved = Poses(pose.rotation, pose.translation + np.array([[*by_m, 0.0]]))
    return view.model_copy(update={"world_SE3_camera": pose_numbers(moved)})
