"""Tests of plants: sizes, silhouettes, numbers of polygons, and reproducibility."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.synth.model import Label, Material, Model
from mirror.synth.street.foliage import apply_season
from mirror.synth.street.plants import PASSING_M, TREES, build_bush, build_crops, build_hedge, build_reeds, build_tree
from tests.draws import draws

_SEEDS = st.integers(0, 2**32 - 1)


def _grown(seed: int) -> list[Model]:
    rng = np.random.default_rng(seed)
    return [
        *(build_tree(rng, kind) for kind in TREES),
        build_bush(rng),
        build_hedge(rng, 5.0),
        build_crops(rng, 6.0),
        build_reeds(rng, 3.0),
    ]


def _bytes(model: Model) -> tuple[bytes, bytes, bytes]:
    return model.faces.tobytes(), model.corners.tobytes(), model.rounds.tobytes()


def test_the_same_seed_gives_the_same_plant() -> None:
    for one, other in zip(_grown(5), _grown(5), strict=True):
        assert _bytes(one) == _bytes(other)
    assert _bytes(_grown(5)[0]) != _bytes(_grown(6)[0])


@pytest.mark.parametrize("kind", TREES)
def test_trees_have_few_polygons_and_the_stated_size(kind: str) -> None:
    for seed in range(6):
        model = build_tree(np.random.default_rng(seed), kind)  # type: ignore[arg-type]
        low, high = model.bounds()
        assert all(40 <= len(apply_season(model, season, 0)) <= 360 for season in (0.0, 0.3, 0.5, 0.8))
        assert 3.9 < high[2] < 18.0
        assert low[2] > -0.7
        assert np.abs(np.r_[low[:2], high[:2]]).max() < 0.62 * high[2]
        assert (model.faces["label"] == Label.VEGETATION).all()


@pytest.mark.parametrize("kind", ["lime", "plane", "birch", "cherry"])
def test_crowns_of_street_trees_leave_room_for_pedestrians(kind: str) -> None:
    for seed in range(6):
        model = build_tree(np.random.default_rng(seed), kind)  # type: ignore[arg-type]
        leaves = model.faces[model.faces["material"] == Material.LEAVES]
        lowest = min(float(model.corners[f : f + n, 2].min()) for f, n in zip(leaves["first"], leaves["count"]))
        assert lowest > 1.4


@settings(max_examples=draws(25), deadline=None)
@given(_SEEDS, st.sampled_from(TREES), st.floats(0.8, 3.0))
def test_no_branch_is_low_over_the_carriageway(seed: int, kind: str, road_m: float) -> None:
    model = build_tree(np.random.default_rng(seed), kind, road_m=road_m)  # type: ignore[arg-type]
    for first, count, material in zip(model.faces["first"], model.faces["count"], model.faces["material"]):
        corners = model.corners[first : first + count]
        over = np.hypot(corners[:, 0], corners[:, 1]) > road_m + 0.05
        if material == Material.LEAVES and over.any():
            assert corners[:, 2].min() >= PASSING_M
    rounds = model.rounds
    over = np.hypot(*rounds["centre"][:, :2].T) + rounds["half"][:, 0] > road_m
    assert (rounds["centre"][:, 2] - rounds["half"][:, 2])[over].min(initial=np.inf) >= PASSING_M


@settings(max_examples=draws(20), deadline=None)
@given(_SEEDS)
def test_every_polygon_is_planar_and_convex(seed: int) -> None:
    for model in _grown(seed):
        for count in np.unique(model.faces["count"]):
            faces = model.faces[model.faces["count"] == count]
            corners = model.corners[faces["first"][:, None] + np.arange(count)]
            away = np.einsum("fni,fi->fn", corners, faces["normal"]) - faces["offset"][:, None]
            assert np.abs(away).max() < 1e-9
            edges = np.roll(corners, -1, axis=1) - corners
            turns = np.cross(edges, np.roll(edges, -1, axis=1))
            assert np.einsum("fni,fi->fn", turns, faces["normal"]).min() > -1e-9


def test_hedges_have_the_stated_size() -> None:
    model = build_hedge(np.random.default_rng(1), 7.0, 1.5, 0.8)
    low, high = model.bounds()
    np.testing.assert_allclose(low[:2], [-3.5, -0.4], atol=0.08)
    np.testing.assert_allclose(high, [3.5, 0.4, 1.5], atol=0.08)
    assert (low[:2] >= [-3.5, -0.4]).all()
    assert (high <= [3.5, 0.4, 1.5]).all()


def test_unknown_kinds_of_tree_are_refused() -> None:
    with pytest.raises(UsageError, match="one of lime"):
        build_tree(np.random.default_rng(0), "baobab")  # type: ignore[arg-type]
