"""Which pictures are matched: by geometry, light and drive, whatever their order."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from hybridworldsim.mvs.images.pairs import choose_sources
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses

LENS = Camera("pinhole", 240, 135, 120.0, 120.0, 120.0, 67.5)
# x east, y down, z north: looks north, level.
NORTH = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])


def shot(
    x: float, y: float, *, drive: str = "a", light: str = "day", back: bool = False, scene: str = "s"
) -> SimpleNamespace:
    matrix = NORTH.copy()
    if back:
        matrix[:3, :3] = NORTH[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    matrix[:2, 3] = x, y
    return SimpleNamespace(
        scene_id=scene, traversal_id=drive, light=light, lens=LENS, world_SE3_camera=Poses.from_matrix(matrix)
    )


def test_a_useful_angle_is_preferred_to_none_and_to_too_much() -> None:
    shots = [shot(0, 0), shot(0, 0), shot(1, 0), shot(12, 0), shot(0, 0, back=True), shot(400, 0)]
    chosen = choose_sources(shots, 4)[0].tolist()
    # The one at the same place, the one that looks back and the one far off give nothing.
    assert chosen == [2, 3]


def test_own_drive_comes_before_like_light_before_other_light() -> None:
    shots = [shot(0, 0), shot(1, 0, drive="c", light="night"), shot(1, 0, drive="b"), shot(1, 0)]
    assert choose_sources(shots, 4)[0].tolist() == [3, 2, 1]


def test_other_scenes_are_never_matched_and_counts_hold() -> None:
    shots = [shot(0, 0), shot(1, 0, scene="t"), shot(1.1, 0), shot(0.9, 0), shot(1.2, 0)]
    chosen = choose_sources(shots, 2)
    assert len(chosen[0]) == 2 and 1 not in chosen[0] and len(chosen[1]) == 0
    assert choose_sources(shots[:1], 4)[0].tolist() == []


def test_the_order_of_other_pictures_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    shots = [shot(*place) for place in rng.uniform(-10, 10, (20, 2)).tolist()]
    order = rng.permutation(20)
    first = choose_sources(shots, 5)
    second = choose_sources([shots[index] for index in order], 5)
    for place, own in enumerate(order.tolist()):
        assert first[own].tolist() == order[second[place]].tolist()
