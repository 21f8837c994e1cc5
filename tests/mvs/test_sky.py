"""Sky masks of drawn pictures; how they do on the synthetic street stands in docs/initialisation.md."""

from __future__ import annotations

import numpy as np
import pytest

from hybridworldsim.mvs.estimator import StereoImage
from hybridworldsim.mvs.sky import compute_ray_rise, find_sky
from mirror.geometry.poses import Poses

SIZE = (60, 80)
# Level, looking north: camera y is the world's down.
LEVEL = Poses.from_matrix(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]))
NOTHING = np.full(SIZE, np.nan, np.float32)


def drawn(sky: tuple[int, int, int], house: tuple[int, int, int]) -> tuple[StereoImage, np.ndarray]:
    rng = np.random.default_rng(0)
    rgb = np.full((*SIZE, 3), house, np.int64) + rng.integers(-40, 40, (*SIZE, 1))
    roof = (14 + 6 * np.sin(np.arange(SIZE[1]) / 9.0)).astype(int)
    truth = np.arange(SIZE[0])[:, None] < roof
    rgb[truth] = sky
    rgb += rng.integers(-1, 2, rgb.shape)
    K = np.array([[60.0, 0, 40], [0, 60.0, 35], [0, 0, 1]])
    picture = StereoImage(np.clip(rgb, 0, 255).astype(np.uint8), K, LEVEL, np.ones(SIZE, np.bool_))
    return picture, truth


@pytest.mark.parametrize("sky", [(200, 215, 235), (225, 225, 225), (20, 24, 48), (235, 180, 150)])
def test_a_sky_over_houses_is_found(sky: tuple[int, int, int]) -> None:
    picture, truth = drawn(sky, (90, 80, 70))
    mask = find_sky(picture, NOTHING)
    assert (mask & truth).sum() / (mask | truth).sum() > 0.85


def test_what_has_a_depth_is_no_sky() -> None:
    picture, truth = drawn((200, 215, 235), (90, 80, 70))
    depth = np.where(truth, 20.0, np.nan).astype(np.float32)
    assert not (find_sky(picture, depth) & truth).any()


def test_rays_rise_where_they_look_up() -> None:
    picture, _ = drawn((200, 215, 235), (90, 80, 70))
    up = compute_ray_rise(picture)
    assert up[0, 40] > 0.4 and up[-1, 40] < -0.3 and abs(up[34, 40]) < 0.02


@pytest.mark.parametrize("value", [0, 90, 255])
def test_flat_pictures_and_masks_over_all(value: int) -> None:
    picture, _ = drawn((200, 215, 235), (90, 80, 70))
    flat = StereoImage(np.full_like(picture.rgb, value), picture.K, LEVEL, picture.valid)
    assert find_sky(flat, NOTHING).shape == SIZE
    hidden = StereoImage(picture.rgb, picture.K, LEVEL, np.zeros(SIZE, np.bool_))
    assert not find_sky(hidden, NOTHING).any()
    down = Poses.from_matrix(np.diag([1.0, -1.0, -1.0, 1.0]))
    assert not find_sky(StereoImage(picture.rgb, picture.K, down, picture.valid), NOTHING).any()
