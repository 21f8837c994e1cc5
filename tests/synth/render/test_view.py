"""Tests of rendered views against rays that are cast one by one in float64."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from mirror.synth.model import Label, Material, Model, block, ellipsoid, merge_models, polygon
from mirror.synth.render.coverage import SKY
from mirror.synth.render.view import rasterize_view
from mirror.synth.truth.casting import cast_rays
from tests.synth.render.scenes import AHEAD, LENSES, ground, lens_of, random_model, surroundings, turned


def directions(name: str, rotation: np.ndarray) -> np.ndarray:
    return lens_of(name).rays.reshape(-1, 3) @ rotation.T


@pytest.mark.parametrize("name", LENSES)
def test_pixel_centres_agree_with_cast_rays(name: str) -> None:
    rng = np.random.default_rng(4)
    wrong = total = 0
    for _ in range(6):
        model, rotation = random_model(rng), turned(rng)
        origin = rng.uniform(-1.0, 1.0, 3)
        view = rasterize_view(surroundings(model), lens_of(name), rotation, origin)
        distance, index = cast_rays(model, origin, directions(name, rotation))
        same = view.surface.ravel() == index
        # Another surface is also correct if both are hit at the same point, as for two touching blocks.
        met = np.isclose(view.distance_m.ravel(), distance, rtol=1e-5) & (view.surface.ravel() != SKY)
        wrong += int((~same & ~met).sum())
        total += len(index)
        close = same & (index != SKY)
        assert np.abs(view.distance_m.ravel()[close] - distance[close]).max(initial=0.0) < 1e-4
        assert np.isinf(view.distance_m.ravel()[index == SKY][same[index == SKY]]).all()
    # A pixel centre within float32 rounding of an edge may fall on either side.
    assert wrong <= 2e-4 * total


def test_distances_on_grazing_ground_are_exact_to_a_tenth_of_a_millimetre() -> None:
    model = ground(400.0, 30)
    view = rasterize_view(surroundings(model), lens_of("pinhole"), AHEAD, np.array([3.0, 2.0, 0.0]))
    rays = directions("pinhole", AHEAD)
    truth = np.where(rays[:, 2] < 0, -1.5 / rays[:, 2], np.inf)
    seen = view.surface.ravel() != SKY
    assert seen.sum() > 0.4 * seen.size
    assert truth[seen].max() > 150.0
    near = seen & (truth < 200.0)
    assert np.abs(view.distance_m.ravel()[near] - truth[near]).max() < 1e-4


def test_normals_are_exact_unit_vectors_towards_the_camera() -> None:
    rng = np.random.default_rng(8)
    model = random_model(rng)
    origin = np.zeros(3)
    view = rasterize_view(surroundings(model), lens_of("kannala_brandt"), AHEAD, origin)
    normals, index = view.normal.reshape(-1, 3), view.surface.ravel()
    seen = index != SKY
    rays = directions("kannala_brandt", AHEAD)
    assert np.abs(np.linalg.norm(normals[seen], axis=1) - 1.0).max() < 1e-5
    assert (np.einsum("ni,ni->n", normals, rays)[seen] <= 1e-6).all()
    flat = seen & (index < len(model.faces))
    truth = model.faces["normal"][index[flat]]
    truth = truth * -np.sign(np.einsum("ni,ni->n", truth, rays[flat]))[:, None]
    assert np.abs(normals[flat] - truth).max() < 1e-6
    ball = seen & ~flat
    rounds = model.rounds[index[ball] - len(model.faces)]
    distance, _ = cast_rays(model, origin, rays[ball])
    local = np.einsum("nij,nj->ni", rounds["axes"], distance[:, None] * rays[ball] + origin - rounds["centre"])
    gradient = np.einsum("nij,ni->nj", rounds["axes"], local / rounds["half"] ** 2)
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    assert ball.sum() > 50
    # Near the silhouette of an ellipsoid, distance and normal are ill-conditioned.
    level = np.einsum("ni,ni->n", gradient, rays[ball]) < -0.05
    assert np.abs(normals[ball] - gradient)[level].max() < 1e-4


def test_no_ray_passes_between_faces_with_a_shared_edge() -> None:
    # A closed room of many triangles, viewed from inside.
    room = block((0.3, -0.2, 0.1), (8.0, 6.0, 4.0), (0.5, 0.5, 0.5), Material.PLAIN, Label.BUILDING, without=())
    pieces = []
    for face in room.faces:
        corners = room.corners[face["first"] : face["first"] + face["count"]][::-1]
        middle = corners.mean(axis=0)
        pieces += [
            polygon([a, b, middle], (0.5, 0.5, 0.5), Material.PLAIN, Label.BUILDING)
            for a, b in zip(corners, np.roll(corners, -1, axis=0))
        ]
    scene = surroundings(merge_models(pieces))
    rng = np.random.default_rng(3)
    for name in ("pinhole", "kannala_brandt", "brown_conrady"):
        for _ in range(5):
            view = rasterize_view(scene, lens_of(name), turned(rng), rng.uniform(-1.0, 1.0, 3))
            assert not (view.surface == SKY).any()
            assert not (view.which[:, 1] == SKY).any()


def test_pixel_shares_equal_the_covered_areas() -> None:
    # The edge of a half plane before the sky, rotated step by step: mean share and share per pixel.
    lens = lens_of("pinhole")
    worst, total = 0.0, []
    for angle in np.linspace(0.05, 3.0, 9):
        along, off = np.array([np.cos(angle), np.sin(angle)]), 3.7
        corners = [off * np.array([-along[1], along[0]]) + s * along * 4000 for s in (-1, 1)]
        corners += [
            corners[1] + 4000 * np.array([-along[1], along[0]]),
            corners[0] + 4000 * np.array([-along[1], along[0]]),
        ]
        # The polygon lies in the image plane, 120 px in front of the camera.
        points = np.array([(120.0, -x, -y * 120.0 / 121.0) for x, y in corners])
        points = points if np.cross(points[1] - points[0], points[2] - points[1])[0] < 0 else points[::-1].copy()
        model = polygon(points, (0.5, 0.5, 0.5), Material.PLAIN, Label.BUILDING)
        view = rasterize_view(surroundings(model), lens, AHEAD, np.zeros(3))
        share = (view.surface == 0).astype(float)
        share[view.mixed > 0] = 0.0
        np.add.at(share.ravel(), view.which[view.which[:, 1] == 0, 0], view.share[view.which[:, 1] == 0, 0])
        x, y = np.meshgrid(np.arange(203) + 0.5 - 101.0, np.arange(117) + 0.5 - 58.0)
        fine = np.linspace(-0.5, 0.5, 41)[:-1] + 0.0125
        side = [(-along[1] * (x + i) + along[0] * (y + j) - off > 0.0) for i in fine[::2] for j in fine[::2]]
        truth = np.mean(side, axis=0)
        worst = max(worst, np.abs(share - truth).max())
        total.append((share - truth)[(truth > 0) & (truth < 1)])
    errors = np.concatenate(total)
    assert worst <= 0.25
    assert np.sqrt(np.mean(errors**2)) < 0.075
    assert abs(errors.mean()) < 0.01


def test_only_surfaces_in_view_are_tested() -> None:
    rng = np.random.default_rng(2)
    near = random_model(rng, 20)
    behind = random_model(rng, 60).place(-120.0, 0.0)
    alone, both = (
        rasterize_view(surroundings(model), lens_of("pinhole"), AHEAD, np.zeros(3))
        for model in (near, merge_models([near, behind]))
    )
    assert both.counts["surfaces"] > 3 * alone.counts["surfaces"]
    assert both.counts["tried"] <= 1.02 * alone.counts["tried"]
    # A wall in front of everything ends the search in its tiles.
    wall = polygon(
        [(2, 50, -50), (2, -50, -50), (2, -50, 50), (2, 50, 50)], (0.5, 0.5, 0.5), Material.PLAIN, Label.WALL
    )
    far = merge_models([block((x, y, 0), (1, 1, 4), (0.5, 0.5, 0.5), Material.PLAIN, Label.BUILDING)
                  for x in range(8, 60, 4) for y in range(-30, 30, 3)])  # fmt: skip
    hidden = rasterize_view(surroundings(merge_models([far, wall])), lens_of("pinhole"), AHEAD, np.zeros(3))
    assert (hidden.label == Label.WALL).all()
    assert hidden.counts["facing"] > 100
    assert hidden.counts["tried"] == hidden.counts["near"] == hidden.counts["tiles"]


def test_views_are_bit_identical_for_any_number_of_threads() -> None:
    scene = surroundings(random_model(np.random.default_rng(5)))

    def image(_: int) -> tuple[bytes, bytes, bytes]:
        view = rasterize_view(scene, lens_of("brown_conrady"), AHEAD, np.zeros(3))
        return view.radiance().tobytes(), view.surface.tobytes(), view.distance_m.tobytes()

    one = image(0)
    with ThreadPoolExecutor(4) as pool:
        assert all(other == one for other in pool.map(image, range(8)))


@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_views_do_not_depend_on_the_distance_from_the_origin(shift: float) -> None:
    model, move = random_model(np.random.default_rng(6)), np.array([shift, -shift, 0.0])
    here = rasterize_view(surroundings(model), lens_of("pinhole"), AHEAD, np.zeros(3))
    there = rasterize_view(surroundings(model.transform(np.eye(3), move)), lens_of("pinhole"), AHEAD, move)
    assert (here.surface != there.surface).mean() < 1e-3
    same = (here.surface == there.surface) & (here.surface != SKY)
    assert np.abs(here.distance_m[same] - there.distance_m[same]).max() < 1e-4


def test_an_empty_scene_shows_only_sky() -> None:
    view = rasterize_view(surroundings(Model.empty()), lens_of("pinhole"), AHEAD, np.zeros(3))
    assert (view.surface == SKY).all()
    assert np.isinf(view.distance_m).all()
    assert (view.normal == 0).all()
    assert (view.label == Label.SKY).all()
    radiance = view.radiance()
    assert np.isfinite(radiance).all()
    assert (radiance[..., :3] > 0).all()


def test_degenerate_camera_positions_give_finite_views() -> None:
    slivers = polygon([(5, 0, 0), (5, 1e-4, 0), (5, 0, 3)], (0.5, 0.5, 0.5), Material.PLAIN, Label.POLE, two_sided=True)
    level = ground(20.0, 3, height_m=0.0)
    ball = ellipsoid((0, 0, 0), (1, 1, 1), (0.5, 0.5, 0.5), Material.PLAIN, Label.FURNITURE)
    view = rasterize_view(surroundings(merge_models([slivers, level, ball])), lens_of("pinhole"), AHEAD, np.zeros(3))
    assert np.isfinite(view.radiance()).all()
    assert (view.distance_m[view.surface != SKY] > 0).all()
    assert not (view.surface >= len(slivers.faces) + len(level.faces)).any()
