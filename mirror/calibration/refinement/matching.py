"""Which images show the same surfaces, and the tracks of features that are matched between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.calibration.refinement.features import ImageFeatures, match_features
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs
from mirror.calibration.tracking import fit_one_pose
from mirror.geometry import matrix_from_quaternion

_DISTANCES_M: Final = (6.0, 15.0, 40.0)
_GRID: Final = (8, 6)
_WIDEST_DEG: Final = 35.0
"""Larger angles between two views of a point are not matched by SIFT."""
_NEAREST_M: Final = 25.0


@dataclass(frozen=True)
class MatchingOptions:
    """Settings of the features and their matches.

    Attributes:
        features: largest number of features of an image.
        own: number of images of the same camera that an image is matched with.
        others: number of images of the other cameras of its vehicle.
        traversals: number of images of each other traversal.
        overlap: least share of an image that both show.
        epipolar_px: largest distance from the epipolar line of the relative pose that most matches fit.
        least: smallest number of matches; a pair of images with fewer is left out.
    """

    features: int = 2000
    own: int = 4
    others: int = 5
    traversals: int = 2
    overlap: float = 0.1
    epipolar_px: float = 2.0
    least: int = 15


def choose_pairs(rigs: MovingRigs, options: MatchingOptions) -> Int64:
    """Return the pairs (N, 2) of images that probably show the same surfaces, the smaller number first.

    For each image the images are counted that see points on its rays, at three assumed distances, at a similar angle.
    """
    poses = rigs.world_SE3_cameras()
    turns, places = matrix_from_quaternion(poses.rotation), poses.translation
    rays = [_grid_rays(rigs, number) for number in range(len(rigs.cameras))]
    chosen: set[tuple[int, int]] = set()
    for image in range(len(rigs.frame)):
        near = np.flatnonzero(np.linalg.norm(places - places[image], axis=1) < _NEAREST_M)
        near = near[near != image]
        ways = rays[rigs.mounting[image]] @ turns[image].T
        share = np.zeros(len(near))
        for distance in _DISTANCES_M:
            points = places[image] + distance * ways
            share = np.maximum(share, _seen_share(rigs, turns, places, near, points, ways))
        share = np.where(share >= options.overlap, share, 0.0)
        own = rigs.mounting[near] == rigs.mounting[image]
        traversal = rigs.traversal[rigs.frame]
        same = traversal[near] == traversal[image]
        groups = [(own & same, options.own), (~own & same, options.others)]
        groups += [
            (traversal[near] == other, options.traversals) for other in np.unique(traversal[near][~same]).tolist()
        ]
        for members, most in groups:
            index = np.flatnonzero(members & (share > 0.0))
            best = index[np.argsort(-share[index], kind="stable")[:most]]
            chosen.update((min(image, int(other)), max(image, int(other))) for other in near[best])
    return np.array(sorted(chosen), np.int64).reshape(-1, 2)


def match_pair(
    rigs: MovingRigs, one: int, other: int, features: Sequence[ImageFeatures], options: MatchingOptions
) -> Int64:
    """Return matches (M, 2) of two images that fit one relative pose; none if fewer than ``options.least`` fit."""
    first, second = features[one], features[other]
    pairs = match_features(first, second)
    if len(pairs) < options.least:
        return np.empty((0, 2), np.int64)
    cameras = [rigs.cameras[rigs.mounting[number]] for number in (one, other)]
    fits = fit_one_pose(
        cameras[0], first.uv_px[pairs[:, 0]], second.uv_px[pairs[:, 1]], options.epipolar_px, cameras[1]
    )
    return pairs[fits] if fits.sum() >= options.least else np.empty((0, 2), np.int64)


def join_tracks(features: Sequence[ImageFeatures], matches: Mapping[tuple[int, int], Int64]) -> FeatureTracks:
    """Join matches to tracks of two or more features; features of a track that share an image are removed."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first = np.concatenate([[0], np.cumsum([len(one) for one in features])]).astype(np.int64)
    ends = [
        np.concatenate(
            [np.empty(0, np.int64), *(first[pair[side]] + found[:, side] for pair, found in matches.items())]
        )
        for side in (0, 1)
    ]
    size = int(first[-1])
    graph = coo_array((np.ones(len(ends[0]), np.int8), (ends[0], ends[1])), shape=(size, size))
    label = connected_components(graph, directed=False)[1] if size else np.empty(0, np.int64)
    image = np.repeat(np.arange(len(features)), np.diff(first))
    # Twice the same image in one track: a wrong match.
    key = label.astype(np.int64) * max(len(features), 1) + image
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    kept = count[inverse] == 1
    kept &= np.bincount(label[kept], minlength=size)[label] >= 2
    index = np.flatnonzero(kept)
    index = index[np.argsort(label[index], kind="stable")]
    track = np.unique(label[index], return_inverse=True)[1].astype(np.int64)
    uv = np.concatenate([np.empty((0, 2)), *(one.uv_px for one in features)])
    scale = np.concatenate([np.empty(0), *(one.scale_px for one in features)])
    return FeatureTracks(track, image[index], uv[index], scale[index])


def _grid_rays(rigs: MovingRigs, mounting: int) -> Float64:
    camera = rigs.cameras[mounting]
    across, down = _GRID
    u, v = np.meshgrid((np.arange(across) + 0.5) / across, (np.arange(down) + 0.5) / down)
    rays = camera.unproject(np.stack([u.ravel() * camera.width_px, v.ravel() * camera.height_px], axis=1))
    return rays.direction[rays.valid]


def _seen_share(
    rigs: MovingRigs, turns: Float64, places: Float64, near: Int64, points: Float64, ways: Float64
) -> Float64:
    """Share (N,) of points (P, 3) that each near image sees at an angle similar to that of the rays (P, 3)."""
    share = np.zeros(len(near))
    for number in np.unique(rigs.mounting[near]):
        own = np.flatnonzero(rigs.mounting[near] == number)
        images = near[own]
        apart = points[None] - places[images][:, None]
        inside = rigs.cameras[number].project(np.einsum("nji,npj->npi", turns[images], apart)).valid
        cosine = np.einsum("npi,pi->np", apart, ways) / np.linalg.norm(apart, axis=2)
        share[own] = (inside & (cosine > np.cos(np.radians(_WIDEST_DEG)))).mean(axis=1)
    return share
