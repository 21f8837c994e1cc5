"""Tests of ray casting against closed-form intersections."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.synth.model import Label, Material, Model, block, ellipsoid, merge_models, polygon
from mirror.synth.truth.casting import NOTHING, cast_rays, ego_mask
from tests.draws import draws
from tests.synth.truth.models import GREY, ball, square


def rays(count: int, seed: int = 0) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_plane_intersections_match_the_closed_form() -> None:
    down = rays(4000) * (1, 1, -1)
    down[:, 2] = -np.abs(down[:, 2])
    origin = np.array([0.3, -0.2, 1.7])
    distance, index = cast_rays(square(6.0), origin, down)
    expected = 1.7 / -down[:, 2]
    at = origin + expected[:, None] * down
    inside = (np.abs(at[:, :2]) <= 3.0).all(axis=1)
    assert np.array_equal(index == 0, inside)
    assert np.abs(distance[inside] / expected[inside] - 1).max() < 1e-14
    assert np.isinf(distance[~inside]).all()
    assert 500 < inside.sum() < 3500


def test_sphere_intersections_match_the_closed_form() -> None:
    centre, radius = np.array([5.0, 2.0, 1.0]), 1.5
    aim = centre + rays(3000) * np.linspace(0, 2.5, 3000)[:, None]
    directions = aim / np.linalg.norm(aim, axis=1, keepdims=True)
    distance, index = cast_rays(ball(tuple(centre), radius), np.zeros(3), directions)
    along = directions @ centre
    room = radius**2 - (centre @ centre - along**2)
    assert np.array_equal(index == 0, room > 0)
    expected = along[room > 0] - np.sqrt(room[room > 0])
    assert np.abs(distance[room > 0] - expected).max() < 1e-6


def test_distances_of_far_ellipsoids_are_exact() -> None:
    far = 1e5
    model = ellipsoid((far, 0, 0), (2.0, 4.0, 1.0), GREY, Material.PLAIN, Label.TERRAIN, yaw=0.0)
    distance, index = cast_rays(
        model, np.zeros(3), np.array([[1.0, 0.0, 0.0], [1.0, 1.9 / far, 0.0], [1.0, 2.1 / far, 0.0]])
    )
    assert index.tolist() == [0, 0, NOTHING]
    assert distance[0] == pytest.approx(far - 1.0, abs=1e-9)
    assert distance[1] == pytest.approx(far - np.sqrt(1 - 0.95**2), abs=1e-3)


def test_the_nearest_surface_wins_and_ellipsoids_are_numbered_after_faces() -> None:
    model = merge_models([square(z=0.0), square(z=-3.0), ball((0, 0, 4.0), 1.0)])
    down, up = np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 2.0]])
    assert [value[0] for value in cast_rays(model, np.array([0.1, 0.0, 2.0]), down)] == [2.0, 0]
    distance, index = cast_rays(model, np.array([0.0, 0.0, 2.0]), up)
    assert (distance[0], index[0]) == (0.5, 2)


def test_one_sided_faces_are_visible_only_from_outside() -> None:
    up = np.array([[0.0, 0.0, 1.0]])
    below = np.array([0.1, 0.2, -1.0])
    assert cast_rays(square(), below, up)[1][0] == NOTHING
    assert cast_rays(square(two_sided=True), below, up)[1][0] == 0
    assert cast_rays(square(), np.array([0.1, 0.2, 0.0]), up)[1][0] == NOTHING


def test_empty_models_and_empty_rays_are_accepted() -> None:
    assert np.isinf(cast_rays(Model.empty(), np.zeros(3), rays(5))[0]).all()
    assert cast_rays(square(), np.zeros(3), np.zeros((0, 3)))[1].shape == (0,)


@settings(max_examples=draws(30), deadline=None)
@given(st.integers(0, 10_000), st.floats(0.1, 30.0), st.floats(-3.0, 3.0))
def test_casting_is_invariant_to_rigid_motions(seed: int, shift: float, yaw: float) -> None:
    model = merge_models(
        [block((4, 0, 1), (2, 3, 2), GREY, Material.PLAIN, Label.CAR, slope=(0.2, 0.1)), ball((-5, 1, 0), 2)]
    )
    directions = rays(200, seed)
    first = cast_rays(model, np.zeros(3), directions)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]])
    moved = model.transform(turn, np.array([shift, -shift, 1.0]))
    again = cast_rays(moved, np.array([shift, -shift, 1.0]), directions @ turn.T)
    assert (first[1] != again[1]).sum() <= 1
    same = (first[1] == again[1]) & (first[1] != NOTHING)
    assert np.abs(first[0][same] - again[0][same]).max(initial=0.0) < 1e-9


def test_ego_mask_of_a_plate_is_its_projection() -> None:
    camera = Camera("pinhole", 64, 48, 40.0, 40.0, 32.0, 24.0)
    # The plate is 2 m ahead in the ego frame and covers 5.2 pixels on each side of the axis.
    h = 2.0 * 5.2 / 40.0
    plate = polygon([(2, h, -h), (2, -h, -h), (2, -h, h), (2, h, h)], GREY, Material.PLAIN, Label.EGO)
    forward, backward = (
        Poses(np.array([q]), np.zeros((1, 3))) for q in ([0.5, -0.5, 0.5, -0.5], [0.5, -0.5, -0.5, 0.5])
    )
    expected = np.zeros((48, 64), np.uint8)
    expected[18:30, 26:38] = 255
    assert np.array_equal(ego_mask(plate, camera, forward), expected)
    assert not ego_mask(plate, camera, backward).any()
