"""Tests of shadows against rays to the sun, of reflections against mirrored models, and of haze."""

from dataclasses import replace

import numpy as np
import pytest

from mirror.synth.light.condition import Effects
from mirror.synth.model import Label, Material, Model, block, merge_models, polygon
from mirror.synth.render.shadows import CELL_M, render_shadow_map, sun_axes, sun_visibility
from mirror.synth.render.surroundings import GROUND_CELL_M
from mirror.synth.render.view import rasterize_view
from mirror.synth.render.wet import add_reflections, fit_ground_plane
from mirror.synth.truth.casting import cast_rays
from tests.synth.render.scenes import AHEAD, ground, lens_of, random_model, surroundings

SUNS = {
    "high": np.array([0.3, -0.4, 0.866]),
    "low": np.array([0.9, 0.35, 0.15]),
    "overhead": np.array([0.0, 0.0, 1.0]),
}


def share_lit(model: Model, sun: np.ndarray, points: np.ndarray) -> np.ndarray:
    found, axes = render_shadow_map(model, sun, np.zeros(3), 200.0), sun_axes(sun)
    at, along = (points @ axes.T - found.origin) / CELL_M, points @ sun
    return np.array([sun_visibility(found.height, c, r, h) for (c, r), h in zip(at, along)])


@pytest.mark.parametrize("name", SUNS)
def test_shadows_agree_with_rays_towards_the_sun(name: str) -> None:
    sun = SUNS[name] / np.linalg.norm(SUNS[name])
    rng = np.random.default_rng(3)
    model = random_model(rng, 30)
    model = Model(model.faces[model.faces["label"] > Label.TERRAIN], model.corners, model.rounds)
    points = rng.uniform(-15, 15, (2000, 3)) - 45.0 * sun

    def is_dark(point: np.ndarray) -> bool:
        # Rays start on the sun's side, because faces are visible from outside only.
        return bool(cast_rays(model, point + 120.0 * sun, -sun[None])[0][0] < 120.0 - 0.01)

    dark = np.array([is_dark(point) for point in points])
    lit = share_lit(model, sun, points)
    assert 0.05 < dark.mean() < 0.95
    wrong = np.abs(lit - ~dark) > 0.5
    assert wrong.mean() < 0.03
    # Differences are allowed only near a shadow's edge, where the surrounding cells disagree.
    axes, steps = sun_axes(sun), np.linspace(-1.2, 1.2, 11)
    for point in points[wrong]:
        around = [point + CELL_M * (a * axes[0] + b * axes[1]) for a in steps for b in steps]
        states = {is_dark(near) for near in around}
        assert len(states) == 2


def test_an_empty_model_casts_no_shadow() -> None:
    found = render_shadow_map(Model.empty(), SUNS["high"], np.zeros(3), 50.0)
    assert found.height.size == 0
    assert sun_visibility(found.height, 3.0, 4.0, 0.0) == 1.0


def test_ground_plane_fit_is_exact_for_a_plane() -> None:
    scene = surroundings(ground(30.0, 3))
    cells = np.arange(-60.0, 61.0, GROUND_CELL_M)
    x, y = np.meshgrid(cells, cells)
    maps = scene.maps.copy()
    maps["ground_origin_0"], maps["ground_origin_1"] = -60.0, -60.0
    sloping = scene._replace(ground=(0.04 * x - 0.02 * y + 3.0).astype(np.float32), maps=maps)
    normal, offset = fit_ground_plane(sloping, np.array([5.3, -8.1, 4.0]))
    truth = np.array([-0.04, 0.02, 1.0]) / np.linalg.norm([-0.04, 0.02, 1.0])
    assert np.abs(normal - truth).max() < 1e-6
    assert offset == pytest.approx(truth[2] * 3.0, abs=1e-5)


def test_wet_ground_mirrors_objects() -> None:
    # A lit board behind the water; its reflection equals a board below the ground.
    board = block((20.0, 0.0, 3.0), (0.5, 4.0, 2.0), (0.9, 0.9, 0.9), Material.PLAIN, Label.BUILDING)
    floor = ground(60.0, 9, height_m=0.0)
    origin = np.array([0.0, 0.0, 2.0])
    effects = replace(Effects.none(), wet_road=True)
    scene = surroundings(merge_models([board, floor]), weather="rain", effects=effects)
    cells = np.zeros((60, 60), np.float32)
    maps = scene.maps.copy()
    maps["ground_origin_0"], maps["ground_origin_1"] = -60.0, -60.0
    scene = scene._replace(ground=cells, maps=maps)
    lens = lens_of("pinhole")
    view = rasterize_view(scene, lens, AHEAD, origin)
    dry = view.radiance()
    assert (dry[..., 3][view.label == Label.ROAD] > 0).all()
    wet = add_reflections(dry, scene, lens, AHEAD, origin)
    below = rasterize_view(
        surroundings(merge_models([board.transform(np.diag([1.0, 1.0, -1.0]), np.zeros(3))])), lens, AHEAD, origin
    )
    there = np.zeros(dry.shape[:2], bool)
    mirrored = polygon(
        [(19.75, -2, -4), (19.75, 2, -4), (19.75, 2, -2), (19.75, -2, -2)], (0.9, 0.9, 0.9), Material.PLAIN,
        Label.BUILDING, two_sided=True,
    )  # fmt: skip
    there = rasterize_view(surroundings(mirrored), lens, AHEAD, origin).surface == 0
    assert there.sum() > 50
    assert below.surface.shape == there.shape
    # The board is reflected there, and the sky elsewhere; in rain the sky is brighter than the board's shaded side.
    gain = (wet - dry * (1.0 - 0.5 * dry[..., 3:]))[..., 1] / np.maximum(dry[..., 3], 1e-6)
    rows, columns = np.nonzero(there)
    middle = gain[int(rows.mean()), int(columns.mean())]
    beside = gain[int(rows.mean()), int(columns.max()) + 12]
    assert middle == pytest.approx(view.radiance()[view.surface < len(board.faces)][:, 1].mean(), rel=0.35)
    assert beside > 1.5 * middle


@pytest.mark.parametrize("distance_m", [5.0, 150.0, 1500.0])
def test_haze_blends_to_the_horizon_with_distance(distance_m: float) -> None:
    wall = polygon(
        [(distance_m, 4000, -4000), (distance_m, -4000, -4000), (distance_m, -4000, 4000), (distance_m, 4000, 4000)],
        (0.0, 0.0, 0.0), Material.PLAIN, Label.WALL,
    )  # fmt: skip
    scene = surroundings(wall, effects=replace(Effects.none(), haze=True))
    lens = lens_of("narrow")
    view = rasterize_view(scene, lens, AHEAD, np.zeros(3))
    setting = scene.setting
    away, glow, sun = (
        np.array([setting[f"{name}_{k}"] for k in range(3)]) for name in ("horizon_away", "horizon_glow", "sun")
    )
    share = (0.5 + 0.5 * (lens.rays @ AHEAD.T)[..., :2] @ sun[:2]) ** 2
    horizon = away + share[..., None] * glow
    truth = horizon * (1.0 - np.exp(-view.distance_m.astype(np.float64) * setting["haze_per_m"]))[..., None]
    assert np.abs(view.radiance()[..., :3] - truth).max() < 1e-4
