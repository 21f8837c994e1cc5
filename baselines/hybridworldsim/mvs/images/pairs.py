"""Chooses the images that each image is matched with: the same points, at a useful angle, in similar light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from hybridworldsim.mvs.images.posed_images import PosedImage
from mirror.arrays import Float64, Int64

_DEPTHS_M: Final = (4.0, 8.0, 16.0, 32.0, 64.0)
_GRID: Final = (1 / 6, 3 / 6, 5 / 6)
_MAX_DISTANCE_M: Final = 30.0
_BEST_DEG: Final = 5.0
_BELOW_DEG: Final = 3.0
_ABOVE_DEG: Final = 10.0
_MIN_AXES_COSINE: Final = 0.2
_SAME_DRIVE: Final = 1.0
_SAME_LIGHT: Final = 0.6
_OTHER_LIGHT: Final = 0.2


def choose_sources(images: Sequence[PosedImage], count: int) -> list[Int64]:
    """Choose the sources of each image, best first.

    The score of a source is a sum over points of the image's frustum that both cameras see. A point is weighted by the
    angle between its two rays (Yao et al., "MVSNet", ECCV 2018, section 4.1: a Gaussian that falls off faster below the
    best angle than above it). Sources of another drive or in other light get a lower score. The candidates are images
    of the same scene within 30 m, found by hashed cells.

    Args:
        images: the images.
        count: greatest number of sources.

    Returns:
        For each image the indices of its sources in ``images``; fewer than ``count`` if few images see its points.
    """
    centre = np.concatenate([image.world_SE3_camera.translation for image in images])
    rotation = np.stack([image.world_SE3_camera.matrix()[0, :3, :3] for image in images])
    lens = np.array(
        [
            [
                image.lens.fx_px,
                image.lens.fy_px,
                image.lens.cx_px,
                image.lens.cy_px,
                image.lens.width_px,
                image.lens.height_px,
            ]
            for image in images
        ]
    )
    _, drive = np.unique([image.traversal_id for image in images], return_inverse=True)
    _, light = np.unique([image.light for image in images], return_inverse=True)
    _, scene = np.unique([image.scene_id for image in images], return_inverse=True)
    neighbours = _make_neighbour_search(centre, rotation[:, :, 2], scene)
    chosen: list[Int64] = []
    for index in range(len(images)):
        near = neighbours(index)
        weight = np.where(light[near] == light[index], _SAME_LIGHT, _OTHER_LIGHT)
        weight = np.where(drive[near] == drive[index], _SAME_DRIVE, weight)
        score = weight * _score_shared_points(index, near, centre, rotation, lens)
        # The earlier image wins a tie.
        order = np.argsort(-score, kind="stable")[:count]
        chosen.append(near[order[score[order] > 0.0]])
    return chosen


def _make_neighbour_search(centre: Float64, axis: Float64, scene: Int64) -> Callable[[int], Int64]:
    """Return a function from an image to the images near it."""
    cell = np.floor(centre[:, :2] / _MAX_DISTANCE_M).astype(np.int64)
    members: dict[tuple[int, int, int], list[int]] = {}
    for number, (x, y) in enumerate(cell.tolist()):
        members.setdefault((int(scene[number]), x, y), []).append(number)

    def near(index: int) -> Int64:
        x, y = cell[index].tolist()
        around = [(int(scene[index]), x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        candidates = np.array(sorted(number for key in around for number in members.get(key, ())), np.int64)
        within = np.linalg.norm(centre[candidates] - centre[index], axis=1) <= _MAX_DISTANCE_M
        similar = axis[candidates] @ axis[index] >= _MIN_AXES_COSINE
        return candidates[within & similar & (candidates != index)]

    return near


def _score_shared_points(index: int, near: Int64, centre: Float64, rotation: Float64, lens: Float64) -> Float64:
    """Sum the weights of the points of an image's frustum that other images see: (len(near),)."""
    fx, fy, cx, cy, width, height = lens[index]
    u, v, depth = np.meshgrid(np.multiply(_GRID, width), np.multiply(_GRID, height), _DEPTHS_M, indexing="ij")
    camera = np.stack([(u - cx) / fx * depth, (v - cy) / fy * depth, depth], axis=-1).reshape(-1, 3)
    world = camera @ rotation[index].T + centre[index]
    to_other = world[None] - centre[near][:, None]
    in_other = np.einsum("nij,nmi->nmj", rotation[near], to_other)
    fx, fy, cx, cy, width, height = (column[:, None] for column in lens[near].T)
    z = np.maximum(in_other[..., 2], 1e-6)
    x, y = fx * in_other[..., 0] / z + cx, fy * in_other[..., 1] / z + cy
    inside = (in_other[..., 2] > 0.5) & (x > 0.0) & (x < width) & (y > 0.0) & (y < height)
    from_index = world - centre[index]
    cosine = np.einsum("mi,nmi->nm", from_index, to_other) / (
        np.linalg.norm(from_index, axis=1) * np.linalg.norm(to_other, axis=2) + 1e-12
    )
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    spread = np.where(angle < _BEST_DEG, _BELOW_DEG, _ABOVE_DEG)
    weight = np.exp(-0.5 * ((angle - _BEST_DEG) / spread) ** 2)
    # Two cameras at the same position cannot triangulate.
    weight[angle < 0.2] = 0.0
    # Windows of different scale do not match.
    ratio = (lens[near, 0][:, None] / z) / (lens[index, 0] / camera[:, 2])
    weight *= np.minimum(ratio, 1.0 / ratio)
    return np.asarray((weight * inside).sum(axis=1))
