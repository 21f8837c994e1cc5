"""Which pictures each picture is matched with: those that see the same points from a useful angle, in like light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from hybridworldsim.mvs.images.posed_images import PosedImage
from mirror.arrays import Float64, Int64

_DEPTHS_M: Final = (4.0, 8.0, 16.0, 32.0, 64.0)
_GRID: Final = (1 / 6, 3 / 6, 5 / 6)
_REACH_M: Final = 30.0
_BEST_DEG: Final = 5.0
_BELOW_DEG: Final = 3.0
_ABOVE_DEG: Final = 10.0
_LEAST_AXES_COSINE: Final = 0.2
_SAME_DRIVE: Final = 1.0
_SAME_LIGHT: Final = 0.6
_OTHER_LIGHT: Final = 0.2


def choose_sources(shots: Sequence[PosedImage], count: int) -> list[Int64]:
    """The sources of each picture, best first.

    Points of the picture's frustum are weighted by the angle under which both cameras see them (Yao et al., "MVSNet",
    ECCV 2018, section 4.1: a Gaussian that falls off faster below the best angle than above it); the sum counts,
    less where the light is another. Only pictures of the same scene within 30 m are looked at, found by hashed cells.

    Args:
        shots: the pictures.
        count: how many sources at most.

    Returns:
        For each picture the positions of its sources in ``shots``; fewer than ``count``, or none, where nothing else
        sees what it sees.
    """
    centre = np.concatenate([one.world_SE3_camera.translation for one in shots])
    rotation = np.stack([one.world_SE3_camera.matrix()[0, :3, :3] for one in shots])
    lens = np.array(
        [
            [one.lens.fx_px, one.lens.fy_px, one.lens.cx_px, one.lens.cy_px, one.lens.width_px, one.lens.height_px]
            for one in shots
        ]
    )
    _, drive = np.unique([one.traversal_id for one in shots], return_inverse=True)
    _, light = np.unique([one.light for one in shots], return_inverse=True)
    _, scene = np.unique([one.scene_id for one in shots], return_inverse=True)
    neighbours = _neighbours(centre, rotation[:, :, 2], scene)
    chosen = []
    for own in range(len(shots)):
        near = neighbours(own)
        weight = np.where(light[near] == light[own], _SAME_LIGHT, _OTHER_LIGHT)
        weight = np.where(drive[near] == drive[own], _SAME_DRIVE, weight)
        score = weight * _seen_together(own, near, centre, rotation, lens)
        # Ties go to the earlier picture.
        order = np.argsort(-score, kind="stable")[:count]
        chosen.append(near[order[score[order] > 0.0]])
    return chosen


def _neighbours(centre: Float64, axis: Float64, scene: Int64) -> Callable[[int], Int64]:
    """A function from a picture to those near it."""
    cell = np.floor(centre[:, :2] / _REACH_M).astype(np.int64)
    members: dict[tuple[int, int, int], list[int]] = {}
    for number, (x, y) in enumerate(cell.tolist()):
        members.setdefault((int(scene[number]), x, y), []).append(number)

    def near(own: int) -> Int64:
        x, y = cell[own].tolist()
        around = [(int(scene[own]), x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        found = np.array(sorted(number for key in around for number in members.get(key, ())), np.int64)
        within = np.linalg.norm(centre[found] - centre[own], axis=1) <= _REACH_M
        alike = axis[found] @ axis[own] >= _LEAST_AXES_COSINE
        return found[within & alike & (found != own)]

    return near


def _seen_together(own: int, near: Int64, centre: Float64, rotation: Float64, lens: Float64) -> Float64:
    """The sum (len(near),) of the weights of the points of a picture's frustum that others see."""
    fx, fy, cx, cy, width, height = lens[own]
    u, v, depth = np.meshgrid(np.multiply(_GRID, width), np.multiply(_GRID, height), _DEPTHS_M, indexing="ij")
    camera = np.stack([(u - cx) / fx * depth, (v - cy) / fy * depth, depth], axis=-1).reshape(-1, 3)
    world = camera @ rotation[own].T + centre[own]
    to_other = world[None] - centre[near][:, None]
    seen = np.einsum("nij,nmi->nmj", rotation[near], to_other)
    fx, fy, cx, cy, width, height = (column[:, None] for column in lens[near].T)
    z = np.maximum(seen[..., 2], 1e-6)
    x, y = fx * seen[..., 0] / z + cx, fy * seen[..., 1] / z + cy
    inside = (seen[..., 2] > 0.5) & (x > 0.0) & (x < width) & (y > 0.0) & (y < height)
    to_own = world - centre[own]
    cosine = np.einsum("mi,nmi->nm", to_own, to_other) / (
        np.linalg.norm(to_own, axis=1) * np.linalg.norm(to_other, axis=2) + 1e-12
    )
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    spread = np.where(angle < _BEST_DEG, _BELOW_DEG, _ABOVE_DEG)
    weight = np.exp(-0.5 * ((angle - _BEST_DEG) / spread) ** 2)
    # From a camera at the same place nothing can be triangulated.
    weight[angle < 0.2] = 0.0
    # A window that covers another's many pixels, or is covered by few, looks different.
    ratio = (lens[near, 0][:, None] / z) / (lens[own, 0] / camera[:, 2])
    weight *= np.minimum(ratio, 1.0 / ratio)
    return np.asarray((weight * inside).sum(axis=1))
