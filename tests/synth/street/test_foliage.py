"""Tests of foliage: monotonic in spring and autumn, and a few different leaves per visit."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.synth.model import Label, Material, Model, block, merge_models
from mirror.synth.street.foliage import Species, apply_season, crown_share, draw_leaf_seeds
from mirror.synth.street.plants import TREES, build_hedge, build_tree

_DECIDUOUS = ("lime", "plane", "birch", "poplar", "cherry", "oak")


def _leaves(model: Model) -> int:
    return int((model.faces["material"] == Material.LEAVES).sum())


@pytest.fixture(scope="module", params=_DECIDUOUS)
def deciduous(request: pytest.FixtureRequest) -> Model:
    return build_tree(np.random.default_rng(11), request.param)


def test_leaves_come_out_in_spring_and_fall_in_autumn(deciduous: Model) -> None:
    spring = [_leaves(apply_season(deciduous, season, 0)) for season in np.linspace(0.2, 0.45, 26)]
    autumn = [_leaves(apply_season(deciduous, season, 0)) for season in np.linspace(0.65, 0.999, 36)]
    assert spring == sorted(spring)
    assert autumn == sorted(autumn, reverse=True)
    assert spring[0] == autumn[-1] == 0
    assert spring[-1] == autumn[0] > 0.9 * _leaves(deciduous)


def test_only_wood_is_left_in_winter(deciduous: Model) -> None:
    bare = apply_season(deciduous, 0.05, 3)
    wood = deciduous.faces["material"] == Material.BARK
    assert len(bare.faces) == wood.sum()
    assert len(bare.rounds) == 0
    for kept, face in zip(bare.faces, deciduous.faces[wood], strict=True):
        np.testing.assert_array_equal(
            bare.corners[kept["first"] : kept["first"] + kept["count"]],
            deciduous.corners[face["first"] : face["first"] + face["count"]],
        )


def test_twigs_are_hidden_while_in_full_leaf(deciduous: Model) -> None:
    wood = [
        int((apply_season(deciduous, season, 0).faces["material"] == Material.BARK).sum()) for season in (0.05, 0.55)
    ]
    assert wood[0] == (deciduous.faces["material"] == Material.BARK).sum()
    assert 12 <= wood[1] < wood[0]


def test_share_of_leaves_matches_the_expectation(deciduous: Model) -> None:
    seeds = deciduous.faces["seed"][deciduous.faces["material"] == Material.LEAVES]
    for season in (0.29, 0.5, 0.82, 0.86):
        there = _leaves(apply_season(deciduous, season, 1)) / len(seeds)
        assert abs(there - 0.965 * crown_share(seeds[:1], season)[0]) < 0.12


@pytest.mark.parametrize("kind", ["spruce", "cypress", "pine"])
def test_evergreens_keep_their_leaves(kind: str) -> None:
    model = build_tree(np.random.default_rng(2), kind)  # type: ignore[arg-type]
    winter, summer = apply_season(model, 0.02, 4), apply_season(model, 0.5, 4)
    assert _leaves(winter) == _leaves(summer)
    np.testing.assert_array_equal(winter.faces["colour"], summer.faces["colour"])


def test_leaves_of_two_visits_differ_by_a_few_percent() -> None:
    model = merge_models([build_tree(np.random.default_rng(n), TREES[n % len(TREES)]) for n in range(12)])
    one, other = (set(apply_season(model, 0.5, visit).faces["seed"].tolist()) for visit in (0, 1))
    differing = len(one ^ other) / len(one | other)
    assert 0.03 < differing < 0.12
    again = apply_season(model, 0.5, 1)
    assert again.faces.tobytes() == apply_season(model, 0.5, 1).faces.tobytes()


def test_leaves_turn_to_warm_colours_in_autumn() -> None:
    model = build_tree(np.random.default_rng(3), "birch")
    leaves = apply_season(model, 0.79, 0).faces
    leaves = leaves[leaves["material"] == Material.LEAVES]["colour"]
    summer = model.faces[model.faces["material"] == Material.LEAVES]["colour"]
    assert (leaves[:, 0] / leaves[:, 1]).mean() > 1.4 * (summer[:, 0] / summer[:, 1]).mean()
    assert leaves.max() <= 0.85


def test_other_surfaces_do_not_change_with_the_season() -> None:
    wall = block((0.0, 0.0, 1.0), (4.0, 1.0, 2.0), (0.5, 0.5, 0.5), Material.BRICK, Label.WALL)
    after = apply_season(wall, 0.1, 9)
    assert after.faces.tobytes() == wall.faces.tobytes()
    assert after.corners.tobytes() == wall.corners.tobytes()
    assert len(apply_season(Model.empty(), 0.5, 0)) == 0


def test_insides_of_hedges_are_visible_on_every_visit() -> None:
    model = build_hedge(np.random.default_rng(4), 6.0)
    body = int((model.faces["two_sided"] == 0).sum())
    assert body == 5
    for visit in range(60):
        assert (apply_season(model, 0.04 + 0.015 * visit, visit).faces["two_sided"] == 0).sum() == body


def test_plain_seeds_are_evergreen_and_seasons_outside_a_year_are_refused() -> None:
    assert (crown_share(np.arange(5), 0.0) == 1.0).all()
    assert (draw_leaf_seeds(np.random.default_rng(0), Species.OAK, 9) >> 24 == Species.OAK).all()
    for season in (-0.1, 1.0, float("nan")):
        with pytest.raises(UsageError, match="fraction of the year"):
            apply_season(Model.empty(), season, 0)
