"""The initial street: anchors on points of multi-view stereo, a grid on the ground, and a hemisphere of sky."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from hybridworldsim.light.recorded_light import RecordedCamera, RecordedLight
from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.densification.cells import best_per_cell, cell_keys
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, Seeds
from hybridworldsim.model.settings import LightSettings, Settings
from hybridworldsim.model.street import StreetModel
from hybridworldsim.trainable.viewpoint import Source
from mirror.arrays import Float64, UInt8

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
_LOWEST_SINE = -0.05
_FLATNESS = 0.2
_OPACITY = 0.95
_FAR_SPACING_M = 2.0
_MAX_DOME_SHARE = 0.9


@dataclass(frozen=True, eq=False)
class InitialGeometry:
    """The geometry of a block before training.

    Attributes:
        points_m: (P, 3) background points in the block's frame.
        far_m: (F, 3) points beyond the block, in the block's frame.
        driven_m: (L, 3) places of vehicles on the ground, in the block's frame.
        ground: returns the height (N,) and the unit normal (N, 3) of the ground at places (N, 2).
        radius_m: radius of the block.
        sources: traversals and cameras of the training images.
        points_rgb: (P, 3) colours of the background points, or None where they are unknown. Explicit Gaussians begin
            with these colours; a street ignores them, because it decodes colours from codes.
        cameras: light and mountings of the sources, for a method that reads them.
    """

    points_m: Float64
    far_m: Float64
    driven_m: Float64
    ground: Callable[[Float64], tuple[Float64, Float64]]
    radius_m: float
    sources: Sequence[Source]
    points_rgb: UInt8 | None = None
    cameras: Sequence[RecordedCamera] = ()


def initial_street(initial: InitialGeometry, settings: Settings) -> StreetModel:
    """Make an untrained street; equal input and seed give an equal street.

    Args:
        initial: geometry of the block.
        settings: sizes and counts.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        background = _background(initial, settings)
        max_count = settings.refinement.most_ground
        ground_start = ground_seeds(initial, settings.ground_spacing_m, settings.ground_reach_m, max_count)
        if not settings.hybrid:
            ground_start = concatenate_seeds(
                ground_start, _round_seeds(_first_points(initial, settings), settings.first_spacing_m)
            )
        sky_start = sky_seeds(initial, settings.sky_count, settings.sky_radius, settings.far_count)
        ground = CodeGaussians(ground_start, settings.plain_code, settings.latent, settings.hidden)
        sky = CodeGaussians(sky_start, settings.plain_code, settings.latent, settings.hidden)
        light = None
        if isinstance(settings, LightSettings):
            light = RecordedLight(initial.cameras, headlights=settings.headlights, seed=settings.seed)
        return StreetModel(background, ground, sky, AppearanceLatents(initial.sources, settings.latent), light)


def thin_points(points: Float64, size_m: float, max_count: int) -> Float64:
    """Keep at most one point (N, 3) per cell; cells grow until at most `max_count` points remain."""
    if max_count < 1:
        return points[:0]
    while len(points):
        keys = cell_keys(torch.from_numpy(points), size_m)
        kept = points[np.sort(best_per_cell(keys, torch.zeros(len(points))).numpy())]
        if len(kept) <= max_count:
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


def background_points(initial: InitialGeometry, spacing_m: float, share: float, max_count: int) -> Float64:
    """Return the points (N, 3) of the background; points far from the driven places are thinned more.

    Args:
        initial: geometry of the block.
        spacing_m: smallest cell that keeps one point.
        share: a cell is at least this share of the distance to the nearest driven place.
        max_count: largest number of points.
    """
    distance, _ = cKDTree(initial.driven_m).query(initial.points_m)
    level = np.ceil(np.log2(np.maximum(share * distance / spacing_m, 1.0))).astype(np.int64)
    spaced = [
        thin_points(initial.points_m[level == index], spacing_m * 2.0**index, len(level))
        for index in range(int(level.max(initial=0)) + 1)
    ]
    return thin_points(np.concatenate(spaced), spacing_m, max_count)


def neighbour_spacing(points: Float64, least_m: float) -> Float64:
    """Return the root mean square distances (N,) of points to the three nearest others.

    Metres, limited to 0.5 to 5 times `least_m`.
    """
    if len(points) < 4:
        return np.full(len(points), least_m)
    distances, _ = cKDTree(points).query(points, k=4)
    return np.clip(np.sqrt((distances[:, 1:] ** 2).mean(axis=1)), 0.5 * least_m, 5.0 * least_m)


def ground_seeds(initial: InitialGeometry, step_m: float, reach_m: float, max_count: int | None = None) -> Seeds:
    """Return the flat Gaussians on the ground; the grid is wider where many streets meet.

    Args:
        initial: geometry of the block.
        step_m: step of the grid at driven places; twice as much at the edge.
        reach_m: largest distance from a driven line.
        max_count: largest number of Gaussians, 1 or more; None: no limit.
    """
    driven = initial.driven_m[:, :2]
    places, width = _rings(driven, step_m, reach_m)
    while max_count is not None and len(places) > max_count:
        step_m *= 1.02 * np.sqrt(len(places) / max_count)
        places, width = _rings(driven, step_m, reach_m)
    heights, normals = initial.ground(places)
    scales = width[:, None] * np.array([0.6, 0.6, 0.1])
    return _seeds(np.column_stack((places, heights)), _rotations_from_z(normals), scales, 0.9)


def _rings(driven: Float64, step_m: float, reach_m: float) -> tuple[Float64, Float64]:
    """Places (N, 2) of three nested grids around driven places (M, 2), and the step (N,) of the grid of each."""
    tree = cKDTree(driven)
    low, high = driven.min(axis=0) - reach_m, driven.max(axis=0) + reach_m
    rings, widths = [], []
    # Each ring is a third of the reach wide; the step grows from 1 to 1.5 and to 2 times.
    for nearest, farthest, factor in ((0.0, 1 / 3, 1.0), (1 / 3, 2 / 3, 1.5), (2 / 3, 1.0, 2.0)):
        axes = [np.arange(start, end, factor * step_m) for start, end in zip(low, high)]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        distance, _ = tree.query(places, distance_upper_bound=reach_m)
        rings.append(places[(distance >= nearest * reach_m) & (distance < farthest * reach_m)])
        widths.append(np.full(len(rings[-1]), factor * step_m))
    return np.concatenate(rings), np.concatenate(widths)


def sky_seeds(initial: InitialGeometry, count: int, radii: float, far_count: int) -> Seeds:
    """Make flat Gaussians on a hemisphere around the block, then round ones on the points beyond the block.

    Points beyond the hemisphere are moved inside it, along the ray from the middle of the block.

    Args:
        initial: geometry of the block.
        count: number of Gaussians on the hemisphere.
        radii: radius of the hemisphere, in block radii.
        far_count: largest number of points beyond the block.
    """
    radius = radii * initial.radius_m
    # A golden-angle spiral: uniform heights on a sphere give equal areas.
    height = _LOWEST_SINE + (1.0 - _LOWEST_SINE) * (np.arange(count) + 0.5) / count
    azimuth = _GOLDEN_ANGLE * np.arange(count)
    horizontal = np.sqrt(1.0 - height**2)
    directions = np.stack((horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), height), axis=1)
    spacing_m = radius * np.sqrt(2.0 * np.pi * (1.0 - _LOWEST_SINE) / count)
    scales = np.tile((0.7 * spacing_m, 0.7 * spacing_m, _FLATNESS * spacing_m), (count, 1))
    dome = _seeds(radius * directions, _rotations_from_z(directions), scales, _OPACITY)
    # The dome would hide points behind it.
    distance = np.linalg.norm(initial.far_m, axis=1, keepdims=True)
    inside = initial.far_m * np.minimum(1.0, _MAX_DOME_SHARE * radius / np.maximum(distance, 1.0))
    return concatenate_seeds(dome, _round_seeds(thin_points(inside, _FAR_SPACING_M, far_count), _FAR_SPACING_M))


def concatenate_seeds(first: Seeds, second: Seeds) -> Seeds:
    """Concatenate two sets of Gaussians; the result has the opacity of the first."""
    return Seeds(
        torch.cat([first.means, second.means]),
        torch.cat([first.quats, second.quats]),
        torch.cat([first.scales, second.scales]),
        first.opacity,
    )


def _round_seeds(points: Float64, least_m: float) -> Seeds:
    identity = np.tile((1.0, 0.0, 0.0, 0.0), (len(points), 1))
    return _seeds(points, identity, np.repeat(0.5 * neighbour_spacing(points, least_m)[:, None], 3, axis=1), _OPACITY)


def _rotations_from_z(normals: Float64) -> Float64:
    """(N, 4) shortest rotations from the z axis to unit normals (N, 3), scalar first."""
    quats = np.column_stack((1.0 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))))
    quats[quats[:, 0] < 1e-9] = (0.0, 1.0, 0.0, 0.0)
    return np.asarray(quats / np.linalg.norm(quats, axis=1, keepdims=True))


def _seeds(means: Float64, quats: Float64, scales: Float64, opacity: float) -> Seeds:
    return Seeds(_float32(means), _float32(quats), _float32(scales), opacity)


def _float32(table: Float64) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(table, np.float32))
