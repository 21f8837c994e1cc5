"""Small scenes for the renderer's tests."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np

from mirror.arrays import Float64
from mirror.geometry.cameras import Camera
from mirror.synth.light.condition import Condition, Effects
from mirror.synth.light.lighting import LIGHTING, Lighting, compute_lighting
from mirror.synth.light.sun import instant_of
from mirror.synth.model import FACE, ROUND, Label, Material, Model, block, ellipsoid, flat, merge_models, polygons, tube
from mirror.synth.render.binning import bounding_spheres
from mirror.synth.render.lens import Lens, make_lens
from mirror.synth.render.shadows import ShadowMap, sun_axes
from mirror.synth.render.surroundings import MAPS, Surroundings
from mirror.synth.roads.markings import MARK

NOTHING = np.zeros((0, 0), np.float32)
AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation world_R_camera of a camera with its axis along +x."""

LENSES = {
    "pinhole": Camera("pinhole", 203, 117, 120.0, 121.0, 101.0, 58.0, ()),
    "brown_conrady": Camera("brown_conrady", 200, 120, 90.0, 90.0, 100.0, 60.0, (-0.17, 0.022, 0.0006, -0.0004, 0.0)),
    "kannala_brandt": Camera("kannala_brandt", 192, 128, 75.0, 75.0, 96.0, 64.0, (-0.012, 0.004, -0.002, 0.0)),
    "narrow": Camera("pinhole", 64, 8, 900.0, 900.0, 32.0, 4.0, ()),
    "one pixel": Camera("pinhole", 1, 1, 10.0, 10.0, 0.5, 0.5, ()),
}


@cache
def lens_of(name: str) -> Lens:
    """A lens, made once; tests do not change it."""
    return make_lens(LENSES[name])


@cache
def lighting_of(light: str, weather: str, effects: Effects) -> Lighting:
    """Light on a summer's day, computed once; tests do not change it."""
    start = instant_of("2025-06-01", light, 8.4, 49.0)  # type: ignore[arg-type]
    return compute_lighting(Condition(start, light, weather, effects=effects), 8.4, 49.0)  # type: ignore[arg-type]


def random_model(rng: np.random.Generator, count: int = 60, spread_m: float = 25.0) -> Model:
    """A random scene of blocks, leaves, tubes and ellipsoids on a triangulated ground."""
    parts, up = [], np.array([0.0, 3.0, 1.0])
    for _ in range(count):
        at, size = rng.uniform(-spread_m, spread_m, 3), rng.uniform(0.2, 5.0, 3)
        if np.linalg.norm(at) > 6.0:
            yaw, slope = rng.uniform(0.0, 6.0), (rng.uniform(0.0, 0.3), 0.1)
            parts.append(block(at, size, (0.5, 0.4, 0.3), Material.PLAIN, Label.BUILDING, yaw=yaw, slope=slope))
            parts.append(ellipsoid(at + up, size, (0.3, 0.4, 0.3), Material.PLAIN, Label.FURNITURE, yaw=yaw))
            parts.append(tube(at, at + rng.normal(0.0, 2.0, 3), 0.1, (0.2, 0.2, 0.2), Material.METAL, Label.POLE))
    middle = rng.uniform(-spread_m, spread_m, (4 * count, 1, 3))
    first, second = rng.normal(0.0, 0.4, (2, 4 * count, 1, 3))
    angle = np.linspace(0.0, 2.0 * np.pi, 5, endpoint=False)[None, :, None]
    leaves = middle + np.cos(angle) * first + np.sin(angle) * second
    parts.append(polygons(leaves, (0.1, 0.3, 0.05), Material.LEAVES, Label.VEGETATION, two_sided=True))
    parts.append(ground(40.0, 7))
    return merge_models(parts)


def ground(reach_m: float, pieces: int, height_m: float = -1.5) -> Model:
    """A level triangulated ground."""
    line = np.linspace(-reach_m, reach_m, pieces)
    found = []
    for a, b in pairwise(line):
        for c, d in pairwise(line):
            found += [[(a, c), (b, c), (b, d)], [(a, c), (b, d), (a, d)]]
    corners = np.array(found)
    return polygons(
        np.concatenate([corners, np.full((*corners.shape[:2], 1), height_m)], axis=2),
        (0.1, 0.1, 0.1), Material.ASPHALT, Label.ROAD, texture=corners,
    )  # fmt: skip


def surroundings(
    model: Model,
    *,
    light: str = "day",
    weather: str = "clear",
    effects: Effects = Effects(),  # noqa: B008
    shadow: ShadowMap | None = None,
) -> Surroundings:
    """A model in a condition, with the given shadows only and level ground."""
    given = lighting_of(light, weather, effects)
    maps = np.zeros(1, MAPS)
    maps["sun_axes"] = sun_axes(np.array(given.record["sun"]))
    shadow = ShadowMap.none() if shadow is None else shadow
    maps["static_shadow_origin"] = shadow.origin
    faces, rounds = model.faces.view(flat(FACE)), model.rounds.view(flat(ROUND))
    spheres = bounding_spheres(faces, model.corners, rounds)
    marks = np.zeros((1, 2), MARK).view(flat(MARK))
    return Surroundings(
        faces, model.corners, rounds, spheres, shadow.height, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING,
        given.dome, given.clouds, marks, given.record.reshape(1).view(flat(LIGHTING))[0], maps.view(flat(MAPS))[0],
    )  # fmt: skip


def turned(rng: np.random.Generator) -> Float64:
    """A random rotation (3, 3)."""
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.ascontiguousarray(rotation * np.sign(np.linalg.det(rotation)))
