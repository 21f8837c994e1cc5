"""Trees, bushes, hedges, crops and reeds in full leaf; `foliage` changes them with the season."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.errors import UsageError
from mirror.portable import arrays
from mirror.synth.model import Label, Material, Model, block, merge_models, polygons
from mirror.synth.model.batches import ellipsoids, tubes
from mirror.synth.street.foliage import Colour, Species, draw_leaf_seeds

Kind = Literal["lime", "plane", "birch", "poplar", "cypress", "spruce", "pine", "cherry", "oak"]

TREES: Final[tuple[Kind, ...]] = ("lime", "plane", "birch", "poplar", "cypress", "spruce", "pine", "cherry", "oak")
STREET_TREES: Final[tuple[Kind, ...]] = ("lime", "plane", "birch", "cherry")
"""Trees along streets; roads through fields and woods have the others."""
PASSING_M: Final = 4.5
"""Smallest height of branches over a carriageway."""
_COVER: Final = 0.72
"""Total area of the leaf sprays as a share of the crown's surface."""
_ROOT_M: Final = 0.5
"""Depth of trunks below the ground, because the ground may slope."""


@dataclass(frozen=True)
class _Habit:
    """Growth parameters of a kind of tree.

    Attributes:
        species: species of its leaves.
        height_m: smallest and largest height.
        spread: diameter of the crown, as a share of the height.
        crown_m: height at which the crown begins.
        lobes: number of ellipsoids that form the crown.
        lobe: radius of an ellipsoid, as a share of the crown's radius there; 1 stacks them around the trunk.
        shape: radius of the crown at its foot, middle and top, as shares of the largest.
        leaves: number of polygons; each is a spray of leaves, and their size is chosen so that they cover the crown.
        narrow: half the width of a spray, as a share of its length.
        hang: from 0 (sprays at random angles) to 1 (sprays hang down).
        leaf: colour of the leaves.
        bark: colour of the bark.
        trunk: radius of the trunk, as a share of the height.
    """

    species: Species
    height_m: tuple[float, float]
    spread: float
    crown_m: float
    lobes: int
    lobe: float
    shape: tuple[float, float, float]
    leaves: int
    narrow: float
    hang: float
    leaf: Colour
    bark: Colour
    trunk: float


_BROWN: Final = (0.11, 0.085, 0.06)
_HABITS: Final[dict[Kind, _Habit]] = {
    "lime": _Habit(
        Species.LIME, (8.0, 11.5), 0.58, 2.7, 17, 0.46, (0.70, 1.0, 0.40), 270, 0.45, 0.3,
        (0.060, 0.115, 0.028), _BROWN, 0.016,
    ),
    "plane": _Habit(
        Species.PLANE, (8.5, 11.5), 0.62, 3.0, 20, 0.42, (0.65, 1.0, 0.55), 290, 0.45, 0.2,
        (0.075, 0.130, 0.034), (0.34, 0.31, 0.24), 0.019,
    ),
    "birch": _Habit(
        Species.BIRCH, (8.0, 12.0), 0.42, 2.5, 15, 0.50, (0.80, 1.0, 0.30), 260, 0.45, 0.8,
        (0.080, 0.140, 0.036), (0.58, 0.57, 0.53), 0.011,
    ),
    "poplar": _Habit(
        Species.POPLAR, (11.0, 16.0), 0.19, 1.6, 13, 0.75, (0.75, 1.0, 0.35), 230, 0.50, -0.4,
        (0.060, 0.115, 0.034), (0.16, 0.145, 0.115), 0.013,
    ),
    "cypress": _Habit(
        Species.EVERGREEN, (5.5, 10.0), 0.17, 0.5, 8, 1.0, (0.80, 1.0, 0.25), 140, 0.40, -0.8,
        (0.028, 0.055, 0.024), _BROWN, 0.012,
    ),
    "spruce": _Habit(
        Species.EVERGREEN, (7.0, 14.0), 0.42, 0.7, 11, 1.0, (1.0, 0.62, 0.10), 250, 0.40, 0.9,
        (0.026, 0.052, 0.028), (0.10, 0.07, 0.05), 0.014,
    ),
    "pine": _Habit(
        Species.EVERGREEN, (9.0, 13.0), 0.42, 5.0, 13, 0.45, (0.60, 1.0, 0.70), 220, 0.50, -0.3,
        (0.036, 0.066, 0.032), (0.24, 0.13, 0.07), 0.014,
    ),
    "cherry": _Habit(
        Species.CHERRY, (4.2, 6.0), 0.80, 2.3, 12, 0.48, (0.75, 1.0, 0.65), 210, 0.45, 0.2,
        (0.062, 0.112, 0.030), (0.12, 0.07, 0.05), 0.018,
    ),
    "oak": _Habit(
        Species.OAK, (7.0, 10.0), 0.90, 2.3, 20, 0.40, (0.75, 1.0, 0.55), 290, 0.45, 0.0,
        (0.055, 0.100, 0.026), (0.12, 0.10, 0.075), 0.024,
    ),
}  # fmt: skip


def build_tree(rng: np.random.Generator, kind: Kind, *, road_m: float = math.inf) -> Model:
    """Build a tree in full leaf; the foot of its trunk is the origin.

    Args:
        rng: random generator that decides its size and growth.
        kind: kind of tree.
        road_m: distance of the carriageway from the trunk; over the carriageway no leaf is below PASSING_M.

    Raises:
        UsageError: the kind is unknown.
    """
    if kind not in _HABITS:
        raise UsageError(f"a tree of kind {kind!r}", expected=f"one of {', '.join(TREES)}")
    habit = _HABITS[kind]
    height = rng.uniform(*habit.height_m)
    centres, halves = _draw_lobes(rng, habit, height, road_m)
    wood = _wood_model(rng, habit, height, centres, halves)
    leaf = np.array(habit.leaf) * rng.uniform(0.85, 1.15) * rng.uniform(0.92, 1.08, 3)
    seeds = draw_leaf_seeds(rng, habit.species, habit.leaves + len(centres))
    crown = _spray_model(rng, centres, halves, habit.leaves, habit.narrow, habit.hang, leaf, seeds, road_m)
    return merge_models([wood, crown, _inside_model(centres, halves, leaf, seeds[habit.leaves :])])


def build_bush(rng: np.random.Generator, *, evergreen: bool = False) -> Model:
    """Build a bush of about 1 to 2 m, centred at the origin."""
    size = rng.uniform(0.5, 1.0)
    spots = rng.normal(0.0, 0.35 * size, (4, 2))
    halves = size * rng.uniform([0.6, 0.6, 0.65], [0.9, 0.9, 1.05], (4, 3))
    centres = np.c_[spots, 0.75 * halves[:, 2]]
    species = Species.EVERGREEN if evergreen else Species.SHRUB
    leaf = np.array((0.04, 0.08, 0.03) if evergreen else (0.07, 0.12, 0.03)) * rng.uniform(0.8, 1.2)
    seeds = draw_leaf_seeds(rng, species, 84)
    crown = _spray_model(rng, centres, halves, 80, 0.6, 0.0, leaf, seeds)
    parts = [crown, _inside_model(centres, halves, leaf, seeds[80:])]
    if not evergreen:
        roots = np.c_[0.3 * spots, np.full(4, -0.1)]
        parts.append(_twig_model(rng, species, _BROWN, centres, halves, roots))
    return merge_models(parts)


def build_hedge(rng: np.random.Generator, length_m: float, height_m: float = 1.3, width_m: float = 0.7) -> Model:
    """Build a clipped evergreen hedge along x, centred at the origin; it extends 0.4 m into the ground."""
    leaf = np.array((0.035, 0.072, 0.028)) * rng.uniform(0.85, 1.3)
    number = max(12, round(9.0 * length_m * (height_m + 0.5 * width_m)))
    seeds = draw_leaf_seeds(rng, Species.EVERGREEN, number + 1)
    inside = block(
        (0.0, 0.0, 0.5 * (height_m - 0.47)), (length_m - 0.1, width_m - 0.14, height_m + 0.33), 0.6 * leaf,
        Material.LEAVES, Label.VEGETATION, seed=int(seeds[number]),
    )  # fmt: skip
    extent = np.array([0.5 * length_m, 0.5 * width_m, height_m])
    areas = np.array([extent[1] * extent[2], extent[0] * extent[2], 2 * extent[0] * extent[1]])
    axis = rng.choice(3, number, p=areas / areas.sum())
    sign = np.where((axis == 2) | (rng.random(number) < 0.5), 1.0, -1.0)
    places = rng.uniform([-1.0, -1.0, 0.05], [1.0, 1.0, 1.0], (number, 3)) * (extent - 0.08)
    outward = np.zeros((number, 3))
    outward[np.arange(number), axis] = sign
    places[np.arange(number), axis] = sign * (extent[axis] - rng.uniform(0.03, 0.09, number))
    corners = _draw_sprays(rng, places, outward, np.full(number, 0.17), 0.75, 0.0, 0.35)
    least, most = [-0.5 * length_m, -0.5 * width_m, 0.0], extent
    corners += np.maximum(least - corners.min(axis=1), 0.0)[:, None]
    corners -= np.maximum(corners.max(axis=1) - most, 0.0)[:, None]
    return merge_models([inside, _leaf_model(rng, corners, leaf * _height_shade(places[:, 2], height_m), seeds)])


def build_crops(rng: np.random.Generator, length_m: float) -> Model:
    """Build a row of corn along x, centred at the origin."""
    number = max(2, round(2.4 * length_m))
    seeds = draw_leaf_seeds(rng, Species.CROP, number)
    place = np.c_[(np.arange(number) + rng.uniform(0.2, 0.8, number)) / number - 0.5, np.zeros(number)]
    foot = place * length_m + rng.normal(0.0, 0.03, (number, 2))
    turn = rng.normal(0.0, 0.35, number)
    return _tuft_model(rng, foot, turn, 0.40, rng.uniform(0.75, 1.05, number), (0.085, 0.15, 0.035), seeds)


def build_reeds(rng: np.random.Generator, length_m: float, width_m: float = 0.8) -> Model:
    """Build reeds or tall grass along x, centred at the origin."""
    number = max(3, round(8.0 * length_m * width_m))
    seeds = draw_leaf_seeds(rng, Species.REED, number)
    foot = rng.uniform(-0.5, 0.5, (number, 2)) * (length_m, width_m)
    turn = rng.uniform(0.0, math.pi, number)
    return _tuft_model(rng, foot, turn, 0.11, rng.uniform(0.5, 1.3, number), (0.15, 0.16, 0.06), seeds)


def _tuft_model(
    rng: np.random.Generator,
    foot_m: Float64,
    turn: Float64,
    half_m: float,
    height_m: Float64,
    colour: Colour,
    seeds: Int64,
) -> Model:
    """Upright tufts at positions (N, 2), wider at the top."""
    number = len(foot_m)
    foot = np.c_[foot_m, np.full(number, -0.1)]
    aside = np.c_[arrays.cos(turn), arrays.sin(turn), np.zeros(number)] * half_m
    # A tuft leans along its own width, so that it stays planar.
    lean = rng.normal(0.0, 0.25, (number, 1)) * aside
    top = foot + lean + np.c_[np.zeros((number, 2)), 0.1 + height_m]
    drop = np.c_[np.zeros((number, 2)), rng.uniform(0.12, 0.3, number) * height_m]
    corners = np.stack([foot - 0.5 * aside, foot + 0.5 * aside, top + aside - drop, top, top - aside - drop], axis=1)
    return _leaf_model(rng, corners, np.tile(colour, (number, 1)), seeds)


def _draw_lobes(rng: np.random.Generator, habit: _Habit, height: float, road_m: float) -> tuple[Float64, Float64]:
    """Centres and half axes (L, 3) of a crown's ellipsoids."""
    number = habit.lobes
    low, high = min(habit.crown_m * rng.uniform(0.95, 1.1), 0.6 * height), height
    radius = 0.5 * habit.spread * height
    share = (np.arange(number) + 0.5) / number
    wide = radius * np.interp(share, [0.0, 0.45, 1.0], habit.shape)
    step = (high - low) / number
    across = habit.lobe * wide * rng.uniform(0.9, 1.1, number)
    tall = np.minimum(np.maximum(0.85 * across, 0.8 * step), 0.5 * (high - low))
    if habit.lobe == 1.0:
        tall = np.full(number, 0.9 * step)
    off = np.maximum(wide - across, 0.0) * rng.uniform(0.8, 1.1, number)
    turn = 2.39996 * np.arange(number) + rng.uniform(0.0, 2.0 * math.pi) + rng.uniform(-0.4, 0.4, number)
    up = np.clip(low + share * (high - low), low + tall, high - tall)
    over = off + across > road_m
    up = np.where(over, np.maximum(up, PASSING_M + tall), up)
    return np.c_[off * arrays.cos(turn), off * arrays.sin(turn), up], np.c_[across, across, tall]


def _spray_model(
    rng: np.random.Generator,
    centres: Float64,
    halves: Float64,
    number: int,
    narrow: float,
    hang: float,
    colour: Float64,
    seeds: Int64,
    road_m: float = math.inf,
) -> Model:
    """Sprays of leaves on the outside of the ellipsoids; none low over the carriageway or in the ground."""
    tries = 4 * number
    # The area is that of a sphere whose squared radius is the mean of the three products of two half axes.
    area = 4.0 / 3.0 * math.pi * halves[:, 0] * (halves[:, 0] + 2.0 * halves[:, 2])
    lobe = rng.choice(len(centres), tries, p=area / area.sum())
    ray = rng.normal(size=(tries, 3))
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    places = centres[lobe] + ray * halves[lobe] * rng.uniform(0.8, 1.05, tries)[:, None]
    inside = (((places[:, None] - centres) / halves) ** 2).sum(axis=2)
    outer = (inside > 0.6).all(axis=1) & (places[:, 2] > 0.05)
    places, lobe, ray = places[outer][:number], lobe[outer][:number], ray[outer][:number]
    outward = ray / halves[lobe]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    size = math.sqrt(_COVER * area.sum() * outer.mean() / (number * 0.76 * math.pi * narrow))
    sizes = size * rng.uniform(0.55, 1.35, len(places))
    corners = _draw_sprays(rng, places, outward, sizes, narrow, hang, 0.65)
    reach = arrays.hypot(corners[..., 0], corners[..., 1]).max(axis=1)
    clear = (corners[..., 2].min(axis=1) > 0.0) & ((reach < road_m) | (corners[..., 2].min(axis=1) >= PASSING_M))
    bright = _height_shade(places[:, 2], float(centres[:, 2].max() + halves[:, 2].max()))
    return _leaf_model(rng, corners[clear], (colour * bright)[clear], seeds[: len(places)][clear])


def _height_shade(up_m: Float64, top_m: float) -> Float64:
    """Brightness (N, 1) of leaves by their height: lower leaves are shaded by higher ones."""
    return (0.72 + 0.36 * np.clip(up_m / top_m, 0.0, 1.0))[:, None]


def _draw_sprays(
    rng: np.random.Generator,
    places: Float64,
    outward: Float64,
    sizes: Float64,
    narrow: float,
    hang: float,
    jitter: float,
) -> Float64:
    """Irregular convex pentagons (N, 5, 3) at positions, facing roughly outwards."""
    number = len(places)
    normal = outward + rng.normal(0.0, jitter, (number, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    wish = (1.0 - abs(hang)) * rng.normal(size=(number, 3)) - [0.0, 0.0, 2.0 * hang]
    along = wish - np.einsum("ni,ni->n", wish, normal)[:, None] * normal
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = np.cross(normal, along)
    # The corners lie on an ellipse with gaps below half a turn, so the polygon is always convex.
    angle = 2.0 * math.pi / 5.0 * (np.arange(5) + rng.uniform(-0.32, 0.32, (number, 5)))
    x, y = sizes[:, None] * arrays.cos(angle), narrow * sizes[:, None] * arrays.sin(angle)
    return places[:, None] + x[..., None] * along[:, None] + y[..., None] * aside[:, None]


def _leaf_model(rng: np.random.Generator, corners: Float64, colours: Float64, seeds: Int64) -> Model:
    number = len(corners)
    shades = colours * rng.uniform(0.78, 1.22, (number, 1)) * rng.uniform(0.93, 1.07, (number, 3))
    return polygons(
        corners, shades, Material.LEAVES, Label.VEGETATION, seeds=seeds[:number], two_sided=True
    )  # fmt: skip


def _inside_model(centres: Float64, halves: Float64, colour: Float64, seeds: Int64) -> Model:
    """The dark inside of each ellipsoid, so that a crown in leaf is not transparent."""
    return ellipsoids(centres, 0.84 * halves, 0.65 * colour, Material.LEAVES, Label.VEGETATION, seeds=seeds)


def _wood_model(rng: np.random.Generator, habit: _Habit, height: float, centres: Float64, halves: Float64) -> Model:
    """Trunk, a limb to every second ellipsoid, and twigs in each."""
    thick = habit.trunk * height
    fork = min(habit.crown_m + 0.5, 0.5 * height)
    lean = rng.normal(0.0, 0.012 * height, 2)
    knee, tip = np.array([*(0.5 * lean), fork]), np.array([*lean, float(centres[:, 2].max())])
    # The upper part begins a little inside the lower one, so that no gap opens at the bend.
    inside = knee - 0.1 * (tip - knee) / arrays.norm(tip - knee)
    trunk = tubes(
        np.array([[0.0, 0.0, -_ROOT_M], inside]), np.array([knee, tip]), np.array([1.15, 0.8]) * thick,
        np.array([0.8, 0.12]) * thick, habit.bark, Material.BARK, Label.VEGETATION,
    )  # fmt: skip
    share = rng.uniform(0.15, 0.6, len(centres))
    rise = np.minimum(fork + share * (tip[2] - fork), np.maximum(centres[:, 2] - 0.5 * halves[:, 2], fork - 0.6))
    starts = np.c_[np.outer(rise / tip[2], lean), rise]
    away = (arrays.hypot(*(centres - starts)[:, :2].T) > 0.15) & (np.arange(len(centres)) % 2 == 0)
    branches = int(away.sum())
    limbs = tubes(
        starts[away], centres[away], np.full(branches, 0.38 * thick), np.full(branches, 0.08 * thick), habit.bark,
        Material.BARK, Label.VEGETATION, corners=3,
    )  # fmt: skip
    if habit.species == Species.EVERGREEN:
        return merge_models([trunk, limbs])
    return merge_models([trunk, limbs, _twig_model(rng, habit.species, habit.bark, centres, halves, starts)])


def _twig_model(
    rng: np.random.Generator, species: Species, bark: Colour, centres: Float64, halves: Float64, starts: Float64
) -> Model:
    """Thin triangles from the limbs to the outside of the ellipsoids: the twigs that are visible in winter."""
    number = 4 * len(centres)
    lobe = np.repeat(np.arange(len(centres)), 4)
    ray = rng.normal(size=(number, 3))
    ray[:, 2] = np.abs(ray[:, 2])
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    ends = centres[lobe] + 0.9 * ray * halves[lobe]
    roots = centres[lobe] + rng.uniform(0.0, 0.6, (number, 1)) * (starts - centres)[lobe]
    across = np.cross(ends - roots, rng.normal(size=(number, 3)))
    across *= 0.025 / np.linalg.norm(across, axis=1, keepdims=True)
    corners = np.stack([roots - across, roots + across, ends], axis=1)
    # The species in their seeds decides when leaves hide the twigs.
    seeds = draw_leaf_seeds(rng, species, number)
    return polygons(
        corners, 0.8 * np.array(bark), Material.BARK, Label.VEGETATION, seeds=seeds, two_sided=True
    )  # fmt: skip
