"""What a street begins with: anchors on the points of multi-view stereo, a grid on the ground, a hemisphere of sky."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.densification.cells import best_per_cell, cell_keys
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, Seeds
from hybridworldsim.model.settings import Settings
from hybridworldsim.model.street import Street
from hybridworldsim.training.viewpoint import Source
from mirror.arrays import Float64, UInt8

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
_LOWEST = -0.05
_THIN = 0.2
_SOLID = 0.95
_FAR_SPACING_M = 2.0
_BEFORE_DOME = 0.9


@dataclass(frozen=True, eq=False)
class InitialGeometry:
    """What is known of a block before it is trained.

    Attributes:
        points_m: (P, 3) of the background, in the block's frame.
        far_m: (F, 3) points beyond the block.
        driven_m: (L, 3) where vehicles drove, on the ground.
        ground: height and unit normal of the ground at (N, 2) places: (N,), (N, 3).
        radius_m: of the block.
        sources: whose images it is trained on.
        points_rgb: (P, 3) colours of the background's points, where they are known. A street reads colours from codes
            and has no use for them; explicit Gaussians begin with them.
    """

    points_m: Float64
    far_m: Float64
    driven_m: Float64
    ground: Callable[[Float64], tuple[Float64, Float64]]
    radius_m: float
    sources: Sequence[Source]
    points_rgb: UInt8 | None = None


def initial_street(initial: InitialGeometry, settings: Settings) -> Street:
    """A street that has seen no image yet; the same for the same input and seed.

    Args:
        initial: what is known.
        settings: sizes and counts.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        background = _background(initial, settings)
        most = settings.refinement.most_ground
        on_ground = ground_seeds(initial, settings.ground_spacing_m, settings.ground_reach_m, most)
        if not settings.hybrid:
            on_ground = concatenate_seeds(on_ground, _round(_first_points(initial, settings), settings.first_spacing_m))
        in_sky = sky_seeds(initial, settings.sky_count, settings.sky_radius, settings.far_count)
        ground = CodeGaussians(on_ground, settings.plain_code, settings.latent, settings.hidden)
        sky = CodeGaussians(in_sky, settings.plain_code, settings.latent, settings.hidden)
        return Street(background, ground, sky, AppearanceLatents(initial.sources, settings.latent))


def thin_points(points: Float64, size_m: float, most: int) -> Float64:
    """Points (N, 3), at most one in a cell of a size, and no more than so many: larger cells where it takes them."""
    if most < 1:
        return points[:0]
    while len(points):
        keys = cell_keys(torch.from_numpy(points), size_m)
        kept = points[np.sort(best_per_cell(keys, torch.zeros(len(points))).numpy())]
        if len(kept) <= most:
            return kept
        size_m *= 1.1
    return points


def _background(initial: InitialGeometry, settings: Settings) -> Anchors:
    points = _first_points(initial, settings) if settings.hybrid else np.empty((0, 3))
    return Anchors(
        torch.from_numpy(points.astype(np.float32)),
        torch.from_numpy(neighbour_spacing(points, settings.first_spacing_m).astype(np.float32)),
        initial.radius_m,
        offsets=settings.offsets,
        code=settings.code,
        latent=settings.latent,
        hidden=settings.hidden,
    )


def _first_points(initial: InitialGeometry, settings: Settings) -> Float64:
    return background_points(initial, settings.first_spacing_m, settings.first_share, settings.first_anchors)


def background_points(initial: InitialGeometry, spacing_m: float, share: float, most: int) -> Float64:
    """Points (N, 3) of the background: those far from where vehicles drive are seen small, and thinned more.

    Args:
        initial: what is known.
        spacing_m: one a cell of this size.
        share: or of this share of the distance from where vehicles drive, if that is more.
        most: so many, at most.
    """
    distance, _ = cKDTree(initial.driven_m).query(initial.points_m)
    level = np.ceil(np.log2(np.maximum(share * distance / spacing_m, 1.0))).astype(np.int64)
    spaced = [
        thin_points(initial.points_m[level == one], spacing_m * 2.0**one, len(level))
        for one in range(int(level.max(initial=0)) + 1)
    ]
    return thin_points(np.concatenate(spaced), spacing_m, most)


def neighbour_spacing(points: Float64, least_m: float) -> Float64:
    """(N,) root of the mean square distance to the three nearest others, metres, from half the least to five times."""
    if len(points) < 4:
        return np.full(len(points), least_m)
    distances, _ = cKDTree(points).query(points, k=4)
    return np.clip(np.sqrt((distances[:, 1:] ** 2).mean(axis=1)), 0.5 * least_m, 5.0 * least_m)


def ground_seeds(initial: InitialGeometry, step: float, reach: float, most: int | None = None) -> Seeds:
    """Flat Gaussians on the ground; on a wider grid where many streets meet.

    Args:
        initial: what is known.
        step: of their grid where vehicles drive, metres; twice as much at the edge.
        reach: how far from a driven line, metres.
        most: so many at most, 1 or more; None: as many as it takes.
    """
    driven = initial.driven_m[:, :2]
    places, width = _rings(driven, step, reach)
    while most is not None and len(places) > most:
        step *= 1.02 * np.sqrt(len(places) / most)
        places, width = _rings(driven, step, reach)
    heights, normals = initial.ground(places)
    scales = width[:, None] * np.array([0.6, 0.6, 0.1])
    return _seeds(np.column_stack((places, heights)), _from_z(normals), scales, 0.9)


def _rings(driven: Float64, step: float, reach: float) -> tuple[Float64, Float64]:
    """Places (N, 2) of grids round driven ones (M, 2), and (N,) the step of the grid that each is of."""
    tree = cKDTree(driven)
    low, high = driven.min(axis=0) - reach, driven.max(axis=0) + reach
    rings, widths = [], []
    # A third of the reach at this grid, a third at one and a half times its step, a third at twice.
    for nearest, farthest, factor in ((0.0, 1 / 3, 1.0), (1 / 3, 2 / 3, 1.5), (2 / 3, 1.0, 2.0)):
        axes = [np.arange(start, end, factor * step) for start, end in zip(low, high)]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        distance, _ = tree.query(places, distance_upper_bound=reach)
        rings.append(places[(distance >= nearest * reach) & (distance < farthest * reach)])
        widths.append(np.full(len(rings[-1]), factor * step))
    return np.concatenate(rings), np.concatenate(widths)


def sky_seeds(initial: InitialGeometry, count: int, radii: float, far_count: int) -> Seeds:
    """Flat Gaussians on a hemisphere round the block, and then round ones on the points beyond the block.

    Points beyond the hemisphere are drawn in before it, along the ray from the middle of the block.

    Args:
        initial: what is known.
        count: on the hemisphere.
        radii: radius of the hemisphere, in block radii.
        far_count: of the points beyond, at most.
    """
    radius = radii * initial.radius_m
    # Equal areas: heights are uniform on a sphere, turned by the golden angle.
    height = _LOWEST + (1.0 - _LOWEST) * (np.arange(count) + 0.5) / count
    around = _GOLDEN * np.arange(count)
    wide = np.sqrt(1.0 - height**2)
    directions = np.stack((wide * np.cos(around), wide * np.sin(around), height), axis=1)
    each = radius * np.sqrt(2.0 * np.pi * (1.0 - _LOWEST) / count)
    flat = np.tile((0.7 * each, 0.7 * each, _THIN * each), (count, 1))
    dome = _seeds(radius * directions, _from_z(directions), flat, _SOLID)
    # Behind the dome nobody would see them.
    away = np.linalg.norm(initial.far_m, axis=1, keepdims=True)
    before = initial.far_m * np.minimum(1.0, _BEFORE_DOME * radius / np.maximum(away, 1.0))
    return concatenate_seeds(dome, _round(thin_points(before, _FAR_SPACING_M, far_count), _FAR_SPACING_M))


def concatenate_seeds(one: Seeds, other: Seeds) -> Seeds:
    """The Gaussians of two, with the opacity of the first."""
    return Seeds(
        torch.cat([one.means, other.means]),
        torch.cat([one.quats, other.quats]),
        torch.cat([one.scales, other.scales]),
        one.opacity,
    )


def _round(points: Float64, least_m: float) -> Seeds:
    turned = np.tile((1.0, 0.0, 0.0, 0.0), (len(points), 1))
    return _seeds(points, turned, np.repeat(0.5 * neighbour_spacing(points, least_m)[:, None], 3, axis=1), _SOLID)


def _from_z(normals: Float64) -> Float64:
    """(N, 4) shortest rotations of the z axis to unit normals."""
    quats = np.column_stack((1.0 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))))
    quats[quats[:, 0] < 1e-9] = (0.0, 1.0, 0.0, 0.0)
    return np.asarray(quats / np.linalg.norm(quats, axis=1, keepdims=True))


def _seeds(means: Float64, quats: Float64, scales: Float64, opacity: float) -> Seeds:
    return Seeds(_float32(means), _float32(quats), _float32(scales), opacity)


def _float32(table: Float64) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(table, np.float32))
