"""Tests sky masks on simple images; docs/initialisation.md has figures for the synthetic street."""

from __future__ import annotations

import numpy as np
import pytest

from hybridworldsim.mvs.estimator import StereoImage
from hybridworldsim.mvs.sky import compute_ray_rise, find_sky
from mirror.geometry.poses import Poses
from tests.mvs.street_image import LEVEL, SIZE, UNKNOWN_DEPTH, make_street_image


@pytest.mark.parametrize("sky", [(200, 215, 235), (225, 225, 225), (20, 24, 48), (235, 180, 150)])
def test_sky_above_houses_is_found(sky: tuple[int, int, int]) -> None:
    image, truth = make_street_image(sky, (90, 80, 70))
    mask = find_sky(image, UNKNOWN_DEPTH)
    assert (mask & truth).sum() / (mask | truth).sum() > 0.85


def test_pixels_with_a_depth_are_not_sky() -> None:
    image, truth = make_street_image((200, 215, 235), (90, 80, 70))
    depth = np.where(truth, 20.0, np.nan).astype(np.float32)
    assert not (find_sky(image, depth) & truth).any()


def test_ray_rise() -> None:
    image, _ = make_street_image((200, 215, 235), (90, 80, 70))
    up = compute_ray_rise(image)
    assert up[0, 40] > 0.4 and up[-1, 40] < -0.3 and abs(up[34, 40]) < 0.02


@pytest.mark.parametrize("value", [0, 90, 255])
def test_flat_and_masked_images(value: int) -> None:
    image, _ = make_street_image((200, 215, 235), (90, 80, 70))
    flat = StereoImage(np.full_like(image.rgb, value), image.K, LEVEL, image.valid)
    assert find_sky(flat, UNKNOWN_DEPTH).shape == SIZE
    hidden = StereoImage(image.rgb, image.K, LEVEL, np.zeros(SIZE, np.bool_))
    assert not find_sky(hidden, UNKNOWN_DEPTH).any()
    down = Poses.from_matrix(np.diag([1.0, -1.0, -1.0, 1.0]))
    assert not find_sky(StereoImage(image.rgb, image.K, down, image.valid), UNKNOWN_DEPTH).any()
