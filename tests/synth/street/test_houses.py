"""Tests of houses: within their lots, closed, with few faces."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.synth.model import Label, Material, Model
from mirror.synth.street.houses import HouseStyle, build_far_houses, build_far_woods, build_house
from mirror.synth.street.houses.windows import PATTERNS, Windows, window_grid
from tests.draws import draws
from tests.synth.street.rays import seen_from_behind

STYLES = get_args(HouseStyle)
OVER_M = 1.35
"""Overhang of balconies and awnings over the street; eaves and foundations overhang less, on all sides."""


def built(style: HouseStyle, seed: int, length: float = 16.0, depth: float = 12.0) -> Model:
    return build_house(np.random.default_rng(seed), style, length, depth)


@pytest.mark.parametrize("style", STYLES)
@settings(max_examples=draws(8), deadline=None)
@given(seed=st.integers(0, 10**6), length=st.floats(9.0, 60.0), depth=st.floats(8.0, 34.0))
def test_houses_stay_within_their_lot(style: HouseStyle, seed: int, length: float, depth: float) -> None:
    low, high = built(style, seed, length, depth).bounds()
    assert low[0] >= -0.5 * length - 0.05
    assert high[0] <= 0.5 * length + 0.05
    assert low[1] >= -OVER_M
    assert high[1] <= depth + 0.5
    assert low[2] == pytest.approx(-1.5)
    assert 2.5 < high[2] < 75.0


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("seed", [0, 1])
def test_houses_are_closed(style: HouseStyle, seed: int) -> None:
    assert seen_from_behind(built(style, seed, 26.0, 20.0), 700, seed) == []


@pytest.mark.parametrize("style", STYLES)
def test_houses_have_few_faces(style: HouseStyle) -> None:
    counts = [len(built(style, seed)) for seed in range(12)]
    assert np.mean(counts) <= 130
    assert max(counts) <= 210
    plain = build_house(np.random.default_rng(1), style, 16.0, 12.0, detailed=False)
    assert len(plain) <= 126


@pytest.mark.parametrize("style", STYLES)
def test_same_seed_same_bytes(style: HouseStyle) -> None:
    one, other = built(style, 5), built(style, 5)
    assert one.faces.tobytes() == other.faces.tobytes()
    assert one.corners.tobytes() == other.corners.tobytes()
    assert built(style, 6).corners.tobytes() != one.corners.tobytes()


@pytest.mark.parametrize("style", STYLES)
def test_corners_lie_in_their_planes(style: HouseStyle) -> None:
    model = built(style, 3)
    for face in model.faces:
        corners = model.corners[face["first"] : face["first"] + face["count"]]
        np.testing.assert_allclose(corners @ face["normal"], face["offset"], atol=1e-9)


@pytest.mark.parametrize("style", ["stucco", "brick", "modern", "panel", "shophouse", "detached", "hall", "tower"])
def test_walls_with_windows_hold_whole_storeys(style: HouseStyle) -> None:
    model = built(style, 7)
    walls = model.faces[(model.faces["material"] == Material.FACADE) & (np.abs(model.faces["normal"][:, 2]) < 0.1)]
    for wall in walls:
        pattern = PATTERNS[Windows(int(wall["layout"]))]
        columns, storeys = window_grid(Windows(int(wall["layout"])), 2 * wall["half"][0], 2 * wall["half"][1])
        if pattern.width_m:
            assert 2 * wall["half"][1] / storeys > pattern.sill_m + pattern.height_m - 0.35
            assert 2 * wall["half"][0] / columns > 0.75 * pattern.width_m


def test_signs_and_doors_are_upright_and_face_outwards() -> None:
    found = 0
    for style in ("stucco", "shophouse", "brick"):
        for seed in range(6):
            faces = built(style, seed).faces
            images = faces[np.isin(faces["material"], (Material.IMAGE, Material.LIT_IMAGE, Material.SHOPFRONT))]
            found += len(images)
            np.testing.assert_allclose(images["v_axis"], [[0.0, 0.0, 1.0]] * len(images), atol=1e-9)
            right = np.cross(np.tile([0.0, 0.0, 1.0], (len(images), 1)), images["normal"])
            np.testing.assert_allclose(images["u_axis"], right, atol=1e-9)
    assert found > 40


def slope(x: float, y: float) -> np.float64:
    return np.float64(0.01 * x - 0.02 * y)


def test_the_skyline_covers_all_directions() -> None:
    for model in (
        build_far_houses(np.random.default_rng(2), 300.0, 420.0, (9.0, 30.0), slope),
        build_far_woods(np.random.default_rng(2), 300.0, 450.0, (9.0, 15.0), slope),
    ):
        assert len(model) < 900
        upright = np.abs(model.faces["normal"][:, 2]) < 1e-6
        first = model.corners[model.faces["first"][upright]]
        assert (np.hypot(first[:, 0], first[:, 1]) > 290.0).all()
        bearings = np.sort(np.arctan2(first[:, 1], first[:, 0]))
        assert np.diff(bearings).max() < 0.2
    woods = model.faces
    assert set(woods["label"]) == {int(Label.VEGETATION)}
    middles = np.array([model.corners[f["first"] : f["first"] + f["count"]].mean(axis=0) for f in woods])
    assert (np.einsum("ni,ni->n", woods["normal"], middles) < 0.0).all()
