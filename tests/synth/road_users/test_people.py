"""Tests of people: reproducible, within their boxes, with feet that do not slide."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mirror.synth.model import Label, Model
from mirror.synth.road_users.body import Saddle
from mirror.synth.road_users.people import Pedestrian, build_rider, draw_pedestrian, draw_person
from mirror.synth.road_users.skeleton import STRIDE, Skeleton, head_half_m, riding_skeleton, walking_skeleton
from mirror.synth.textures.catalogue import FACES
from mirror.traffic.placement.motion import Placement
from tests.draws import draws

_SADDLE = Saddle((-0.20, 0.0, 0.94), (0.42, 0.28, 1.02), (-0.02, 0.12, 0.12), (0.02, -0.12, 0.46))
_SEEDS = st.integers(0, 2**32 - 1)


def _somebody(seed: int) -> Pedestrian:
    rng = np.random.default_rng(seed)
    return draw_pedestrian(rng, child=seed % 4 == 3, umbrella=seed % 5 == 4, warm=seed % 2 == 1)


def _bytes(model: Model) -> bytes:
    return model.faces.tobytes() + model.corners.tobytes() + model.rounds.tobytes()


def test_the_same_seed_draws_the_same_person() -> None:
    assert _bytes(_somebody(4).walking(0.3)) == _bytes(_somebody(4).walking(0.3))
    assert _bytes(_somebody(4).walking(0.3)) != _bytes(_somebody(5).walking(0.3))
    one, other = (build_rider(np.random.default_rng(2), _SADDLE) for _ in range(2))
    assert _bytes(one) == _bytes(other)


@settings(max_examples=draws(40), deadline=None)
@given(_SEEDS, st.floats(0.0, 5.0), st.floats(0.0, 1.0))
@example(83, 1.125, 1.0).via("a handbag swings furthest between the steps")
def test_all_poses_are_within_the_box_and_on_the_ground(seed: int, phase: float, pace: float) -> None:
    body = _somebody(seed)
    low, high = body.walking(phase, pace).bounds()
    length, width, height = body.size_m
    assert (low >= [-0.5 * length, -0.5 * width, -0.001]).all()
    assert (high <= [0.5 * length, 0.5 * width, height]).all()
    assert low[2] < 0.02


@settings(max_examples=draws(30), deadline=None)
@given(_SEEDS)
def test_box_is_tight_around_the_poses(seed: int) -> None:
    body = _somebody(seed)
    models = [body.model, *(body.walking(phase) for phase in np.linspace(0.0, 1.0, 25))]
    most = np.array([np.abs(model.bounds()).max(axis=0) for model in models]).max(axis=0)
    assert (np.array(body.size_m) * [0.5, 0.5, 1.0] - most < 0.005).all()


def test_people_have_few_primitives_and_one_face() -> None:
    for seed in range(20):
        body = _somebody(seed)
        assert len(body.model) <= (40 if body.person.umbrella is None else 45)
        assert body.category == "pedestrian"
        images = body.model.rounds["image"]
        assert (images >= 0).sum() == 1
        assert images.max() in FACES
        assert (body.model.rounds["label"] == Label.PERSON).all()
        assert (body.model.faces["label"] == Label.PERSON).all()


def _bones(pose: Skeleton) -> np.ndarray:
    ends = (pose.hips, pose.knees), (pose.knees, pose.ankles), (pose.shoulders, pose.elbows), (pose.elbows, pose.wrists)
    return np.array([np.linalg.norm(end - start, axis=1) for start, end in ends])


def test_bones_keep_their_lengths_while_walking() -> None:
    bones = np.array([_bones(walking_skeleton(1.7, phase, 1.0)) for phase in np.linspace(0.0, 1.0, 60)])
    np.testing.assert_allclose(bones, np.broadcast_to(bones[0, :, :1], bones.shape), atol=1e-9)


def test_the_supporting_foot_does_not_slide() -> None:
    height = 1.75
    for phase in np.linspace(0.02, 0.35, 12):
        one, other = walking_skeleton(height, phase, 1.0), walking_skeleton(height, phase + 0.02, 1.0)
        moved = other.ankles[0, 0] + 0.02 * STRIDE * height - one.ankles[0, 0]
        assert abs(moved) < 1e-9
        assert one.ankles[0, 2] == pytest.approx(0.041 * height)


def test_the_gait_repeats_and_mirrors_after_half_a_stride() -> None:
    left, right = walking_skeleton(1.6, 0.2, 1.0), walking_skeleton(1.6, 0.7, 1.0)
    for name in ("hips", "knees", "ankles", "elbows", "wrists"):
        mirrored = getattr(right, name)[::-1] * [1.0, -1.0, 1.0]
        np.testing.assert_allclose(getattr(left, name), mirrored, atol=1e-9)
    np.testing.assert_allclose(walking_skeleton(1.6, 1.2, 1.0).ankles, left.ankles, atol=1e-9)


def test_standing_people_have_the_stated_height() -> None:
    for height in (1.05, 1.5, 1.9):
        pose = walking_skeleton(height, 0.0, 0.0)
        assert pose.head[2] + head_half_m(height) == pytest.approx(height, abs=0.013)
        assert np.ptp(pose.ankles[:, 0]) < 1e-9


def test_steps_follow_the_distance_travelled() -> None:
    body = _somebody(0)
    still = body.model_at(Placement(0.0, 0.0, 0.0, 0.0))
    assert still is body.model
    steps = [body.model_at(Placement(0.0, 0.0, 0.0, 0.0, speed_mps=1.2, along_m=along)) for along in (0.0, 0.3)]
    assert _bytes(steps[0]) != _bytes(steps[1])
    round_ = body.model_at(Placement(0.0, 0.0, 0.0, 0.0, speed_mps=1.2, along_m=0.3 + body.stride_m))
    np.testing.assert_allclose(round_.rounds["centre"], steps[1].rounds["centre"], atol=1e-9)


def test_riders_reach_grips_and_pedals() -> None:
    for height in (1.7, 1.78, 1.9):
        pose = riding_skeleton(height, _SADDLE)
        assert np.abs(_bones(pose)[1] - 0.246 * height).max() < 0.02
        grips = np.array([_SADDLE.hand, np.array(_SADDLE.hand) * [1, -1, 1]])
        assert np.linalg.norm(pose.wrists - grips, axis=1).max() < 0.12
        assert pose.head[2] > pose.hips[0, 2] + 0.4
    model = build_rider(np.random.default_rng(8), _SADDLE, motorcycle=True)
    assert (model.rounds["image"] < 0).all()
    assert (model.rounds["label"] == Label.RIDER).all()
    assert len(model) <= 40


def test_children_are_small_and_clothes_fit_the_weather() -> None:
    rng = np.random.default_rng(0)
    assert all(draw_person(rng, child=True).height_m < 1.46 for _ in range(20))
    assert draw_person(rng, umbrella=True).umbrella is not None
    garments = {draw_person(rng, warm=True).garment for _ in range(60)}
    assert "shirt" in garments
    assert "coat" not in garments
