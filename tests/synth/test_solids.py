"""Rays against solids, held against membership of points: inside or outside is defined without any ray."""

import math

import numpy as np
import pytest

from mirror.geometry.cameras import Camera
from mirror.synth.render.casting import GROUND, SKY, cast, choose, make_lens, sight
from mirror.synth.render.primitives import (
    BLOCK,
    CYLINDER,
    ELLIPSOID,
    SOLID,
    flat,
    local,
    meet,
    normal,
    placed,
    solid,
)

SHAPES = {
    "block": {"shape": BLOCK},
    "sloped block": {"shape": BLOCK, "slope": (0.7, 0.3)},
    "ellipsoid": {"shape": ELLIPSOID},
    "cylinder": {"shape": CYLINDER},
}
SIZE = np.array([4.0, 1.8, 1.4])


def inside(kind: str, points: np.ndarray) -> np.ndarray:
    x, y, z = points.T
    half = SIZE / 2
    if kind == "ellipsoid":
        return np.sum((points / half) ** 2, axis=1) < 1
    if kind == "cylinder":
        return (x**2 + z**2 < half[0] ** 2) & (np.abs(y) < half[1])
    front, back = (0.7, 0.3) if kind == "sloped block" else (0.0, 0.0)
    ends = (x < half[0] - front * (z + half[2])) & (x > -half[0] + back * (z + half[2]))
    return ends & (np.abs(y) < half[1]) & (np.abs(z) < half[2])


def one(kind: str) -> np.ndarray:
    size = SIZE if kind != "cylinder" else np.array([SIZE[0], SIZE[1], SIZE[0]])
    return solid((3.0, -2.0, 1.0), size, (1, 1, 1), 0, yaw=0.6, **SHAPES[kind]).view(flat(SOLID))[0]


@pytest.mark.parametrize("kind", SHAPES)
def test_a_ray_enters_where_membership_begins(kind: str) -> None:
    rng = np.random.default_rng(5)
    target = one(kind)
    steps = np.linspace(0.0, 30.0, 3001)
    hits = 0
    for _ in range(150):
        origin = np.array([3.0, -2.0, 1.0]) + rng.normal(size=3) * 6
        aim = np.array([3.0, -2.0, 1.0]) + rng.normal(size=3) - origin
        direction = aim / np.linalg.norm(aim)
        along = np.array([local(target, *(origin + t * direction)) for t in steps])
        member = inside(kind, along)
        if member[0]:
            continue
        t, face = meet(target, *origin, *direction, 1e9)
        if not member.any():
            # A chord shorter than the step may slip between two samples.
            assert (
                face < 0 or t > 30.0 or inside(kind, np.array([local(target, *(origin + (t + 1e-7) * direction))]))[0]
            )
            continue
        hits += 1
        first = steps[np.argmax(member)]
        assert first - 0.01 - 1e-9 <= t <= first
        at = np.array(local(target, *(origin + t * direction)))
        outward = np.array(normal(target, face, *at))
        assert abs(np.linalg.norm(outward) - 1) < 1e-12
        assert outward @ direction < 0
        beside = np.array([local(target, *(origin + t * direction + sign * 1e-6 * outward)) for sign in (1, -1)])
        assert inside(kind, beside).tolist() == [False, True]
    assert hits > 40


def test_nothing_is_met_from_inside_behind_or_beyond_the_limit() -> None:
    block = one("block")
    assert meet(block, 3.0, -2.0, 1.0, 1.0, 0.0, 0.0, 1e9)[1] == -1
    assert meet(block, 3.0, -2.0, 9.0, 0.0, 0.0, 1.0, 1e9)[1] == -1
    assert meet(block, 3.0, -2.0, 9.0, 0.0, 0.0, -1.0, 5.0)[1] == -1
    assert meet(block, 3.0, -2.0, 9.0, 0.0, 0.0, -1.0, 1e9)[0] == pytest.approx(9.0 - 1.7, abs=1e-12)


def test_placed_solids_meet_moved_rays_at_the_same_distance() -> None:
    angle = 0.8
    turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    shift = np.array([150.0, -80.0, 2.0])
    first = solid((0, 0, 1), SIZE, (1, 1, 1), 0, yaw=0.3, slope=(0.4, 0.1))
    origin, direction = np.array([-9.0, 2.0, 1.2]), np.array([0.97, -0.2, -0.03])
    t, face = meet(first.view(flat(SOLID))[0], *origin, *direction, 1e9)
    moved = placed(first, turn, shift, 7).view(flat(SOLID))[0]
    again, same = meet(moved, *(turn @ origin + shift), *(turn @ direction), 1e9)
    assert face == same >= 0
    assert again == pytest.approx(t, abs=1e-9)
    assert moved["object"] == 7


@pytest.mark.parametrize(
    "camera",
    [
        Camera("kannala_brandt", 96, 54, 40.0, 40.0, 48.0, 27.0, (-0.012, 0.004, -0.002, 0.0)),
        Camera("brown_conrady", 96, 54, 45.0, 45.0, 47.0, 27.5, (-0.17, 0.022, 0.0006, -0.0004, 0.0)),
        Camera("pinhole", 90, 50, 160.0, 160.0, 45.0, 25.0),
    ],
)
def test_no_solid_that_a_tile_sees_is_left_out(camera: Camera) -> None:
    rng = np.random.default_rng(3)
    many = np.concatenate(
        [
            solid(
                rng.uniform(-40, 40, 3), rng.uniform(0.2, 12, 3), (1, 1, 1), 0,
                shape=int(rng.integers(3)), yaw=rng.uniform(0, 6), slope=(0.1, 0.0),
            )
            for _ in range(300)
        ]
    )  # fmt: skip
    solids, lens, origin = many.view(flat(SOLID)), make_lens(camera), np.zeros(3)
    away, spread, near, order = sight(many, origin)
    starts, lists = choose(lens.cones, np.eye(3), away, spread, order)
    everything = order.astype(np.int32)
    across = lens.cones.shape[1]
    seen = 0
    for row in range(0, camera.height_px, 3):
        for column in range(0, camera.width_px, 3):
            tile = row // 16 * across + column // 16
            chosen = lists[starts[tile] : starts[tile + 1]]
            ray = lens.rays[row, column]
            few = cast(solids, chosen, near, False, *origin, *ray)
            assert few == cast(solids, everything, near, False, *origin, *ray)
            seen += few[1] >= 0
    assert seen > 50
    assert starts[-1] < 0.5 * len(solids) * (len(starts) - 1)


def test_ground_and_sky_are_where_nothing_stands() -> None:
    none = np.zeros(0, flat(SOLID))
    empty = np.zeros(0, np.int32)
    down = cast(none, empty, np.zeros(0), True, 0.0, 0.0, 1.5, 0.8, 0.0, -0.6)
    assert down[0] == pytest.approx(2.5)
    assert down[1] == GROUND
    assert cast(none, empty, np.zeros(0), True, 0.0, 0.0, 1.5, 0.8, 0.0, 0.6)[1] == SKY
    assert cast(none, empty, np.zeros(0), False, 0.0, 0.0, 1.5, 0.8, 0.0, -0.6)[1] == SKY
