"""Tests that sources are chosen by geometry, light and drive, in any order of images."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from hybridworldsim.mvs.images.pairs import choose_sources
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses

LENS = Camera("pinhole", 240, 135, 120.0, 120.0, 120.0, 67.5)
# x east, y down, z north: looks north, level.
NORTH = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])


def make_image(
    x: float, y: float, *, drive: str = "a", light: str = "day", back: bool = False, scene: str = "s"
) -> SimpleNamespace:
    matrix = NORTH.copy()
    if back:
        matrix[:3, :3] = NORTH[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    matrix[:2, 3] = x, y
    return SimpleNamespace(
        scene_id=scene, traversal_id=drive, light=light, lens=LENS, world_SE3_camera=Poses.from_matrix(matrix)
    )


def test_useful_angle_is_preferred() -> None:
    images = [
        make_image(0, 0),
        make_image(0, 0),
        make_image(1, 0),
        make_image(12, 0),
        make_image(0, 0, back=True),
        make_image(400, 0),
    ]
    chosen = choose_sources(images, 4)[0].tolist()
    # The image at the same position, the one that faces back and the distant one are useless.
    assert chosen == [2, 3]


def test_same_drive_ranks_before_same_light_before_other_light() -> None:
    images = [
        make_image(0, 0),
        make_image(1, 0, drive="c", light="night"),
        make_image(1, 0, drive="b"),
        make_image(1, 0),
    ]
    assert choose_sources(images, 4)[0].tolist() == [3, 2, 1]


def test_other_scenes_are_not_matched_and_counts_are_limits() -> None:
    images = [make_image(0, 0), make_image(1, 0, scene="t"), make_image(1.1, 0), make_image(0.9, 0), make_image(1.2, 0)]
    chosen = choose_sources(images, 2)
    assert len(chosen[0]) == 2 and 1 not in chosen[0] and len(chosen[1]) == 0
    assert choose_sources(images[:1], 4)[0].tolist() == []


def test_order_of_images_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    images = [make_image(*position) for position in rng.uniform(-10, 10, (20, 2)).tolist()]
    order = rng.permutation(20)
    first = choose_sources(images, 5)
    second = choose_sources([images[index] for index in order], 5)
    for row, index in enumerate(order.tolist()):
        assert first[index].tolist() == order[second[row]].tolist()
