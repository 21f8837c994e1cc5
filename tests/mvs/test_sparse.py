"""Tests sparse points of a textured wall against the wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybridworldsim.mvs.sparse import Features, extract_features, match_features, triangulate
from tests.mvs.images import SIZE, Wall, make_image

pytest.importorskip("pycolmap")


def test_points_lie_on_the_wall_in_its_colours() -> None:
    wall = Wall((0.2, 0.0, 0.97), 8.0, seed=5)
    images = [make_image(wall, x) for x in (0.0, 0.4, 0.8, 1.2)]
    sources = [np.array([other for other in range(4) if other != index]) for index in range(4)]
    points = triangulate(images.__getitem__, sources)
    off = points.cloud.position_m @ np.array(wall.normal) - wall.offset_m
    assert len(points.cloud) >= 10 and np.median(np.abs(off)) < 0.1
    assert points.cloud.views.min() >= 2 and points.first_image.max() <= 2 and np.isnan(points.cloud.sigma_m).all()
    assert points.cloud.rgb.std(axis=1).max() == 0.0


def test_matches_are_mutual_and_clear() -> None:
    rng = np.random.default_rng(2)
    descriptors = rng.integers(0, 255, (40, 128)).astype(np.uint8)
    order = rng.permutation(40)
    uv = rng.uniform(0.0, 100.0, (40, 2))
    everywhere = np.zeros((3, 3))  # the line of each point has the distance zero to each other point
    first, second = Features(uv, descriptors), Features(uv[order], descriptors[order])
    pairs = match_features(first, second, everywhere)
    assert len(pairs) == 40 and (order[pairs[:, 1]] == pairs[:, 0]).all()
    twice = Features(np.concatenate([uv, uv]), np.concatenate([descriptors, descriptors]))
    assert not len(match_features(first, twice, everywhere))
    assert not len(match_features(first, Features(uv[:1], descriptors[:1]), everywhere))


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_uniform_image_has_no_features(grey: int) -> None:
    flat = replace(make_image(Wall(), 0.0), rgb=np.full((*SIZE[::-1], 3), grey, np.uint8))
    points = extract_features(flat)
    assert points.uv_px.shape == (0, 2) and points.descriptors.shape == (0, 128)
    wall = Wall((0.2, 0.0, 0.97), 8.0, seed=5)
    images = [flat, *(make_image(wall, x) for x in (0.4, 0.8, 1.2))]
    sources = [np.array([other for other in range(4) if other != index]) for index in range(4)]
    assert len(triangulate(images.__getitem__, sources).cloud) > 0


def test_flat_masked_or_single_images_give_no_points() -> None:
    wall, nowhere = Wall(), np.zeros(SIZE[::-1], np.bool_)
    hidden = make_image(wall, 0.0, valid=nowhere)
    assert len(extract_features(hidden).uv_px) == 0
    for images in ([hidden, make_image(wall, 0.5)], [make_image(wall, 0.0)]):
        sources = [
            np.array([other for other in range(len(images)) if other != index], np.int64)
            for index in range(len(images))
        ]
        assert len(triangulate(images.__getitem__, sources).cloud) == 0
