"""Sparse points of a textured wall, against the wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybridworldsim.mvs.sparse import extract_features, triangulate
from tests.mvs.images import SIZE, Wall, seen

pytest.importorskip("pycolmap")


def test_points_lie_on_the_wall_and_have_its_colours() -> None:
    wall = Wall((0.2, 0.0, 0.97), 8.0, seed=5)
    pictures = [seen(wall, x) for x in (0.0, 0.4, 0.8, 1.2)]
    sources = [np.array([other for other in range(4) if other != own]) for own in range(4)]
    found = triangulate(pictures.__getitem__, sources)
    off = found.cloud.position_m @ np.array(wall.normal) - wall.offset_m
    assert len(found.cloud) >= 10 and np.median(np.abs(off)) < 0.1
    assert found.cloud.views.min() >= 2 and found.first.max() <= 2 and np.isnan(found.cloud.sigma_m).all()
    assert found.cloud.rgb.std(axis=1).max() == 0.0


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_a_picture_of_one_grey_has_no_features(grey: int) -> None:
    flat = replace(seen(Wall(), 0.0), rgb=np.full((*SIZE[::-1], 3), grey, np.uint8))
    found = extract_features(flat)
    assert found.uv_px.shape == (0, 2) and found.descriptors.shape == (0, 128)
    wall = Wall((0.2, 0.0, 0.97), 8.0, seed=5)
    pictures = [flat, *(seen(wall, x) for x in (0.4, 0.8, 1.2))]
    sources = [np.array([other for other in range(4) if other != own]) for own in range(4)]
    assert len(triangulate(pictures.__getitem__, sources).cloud) > 0


def test_nothing_comes_of_flat_masked_or_single_pictures() -> None:
    wall, none = Wall(), np.zeros(SIZE[::-1], np.bool_)
    hidden = seen(wall, 0.0, valid=none)
    assert len(extract_features(hidden).uv_px) == 0
    for pictures in ([hidden, seen(wall, 0.5)], [seen(wall, 0.0)]):
        sources = [
            np.array([other for other in range(len(pictures)) if other != own], np.int64)
            for own in range(len(pictures))
        ]
        assert len(triangulate(pictures.__getitem__, sources).cloud) == 0
