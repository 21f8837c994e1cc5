"""The vehicle in a map: the direction of travel, the vertical, and the height of the camera above the road."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.geometry import Poses, matrix_from_quaternion

LEAST_POINTS: Final = 20
_LANE: Final = 0.75
"""Half width of the strip below the way, in heights of the camera: what lies in it was driven over."""
_STEP: Final = 0.02
_RIDGE: Final = 0.06


@dataclass(frozen=True)
class RoadHeight:
    """The height of a camera above the road, in units of the map.

    Attributes:
        height: the height.
        sigma: its 1-sigma.
        points: number of points on the road.
    """

    height: float
    sigma: float
    points: int


def travel_directions(poses: Poses) -> Float64:
    """Return the directions (N, 3) of travel at poses, unit vectors; those of a vehicle that stands are the nearest."""
    places = poses.translation
    way = np.gradient(places, axis=0)
    length = np.linalg.norm(way, axis=1)
    moving = np.flatnonzero(length > 0.2 * np.median(length[length > 0.0]))
    nearest = moving[np.abs(np.arange(len(places))[:, None] - moving[None, :]).argmin(axis=1)]
    return way[nearest] / length[nearest, None]


def mounting_rotation(poses: Poses) -> Float64:
    """Return the rotation ego_R_camera (3, 3) of a camera whose mounting is unknown.

    The vehicle drives forward; the image is upright: the roll of the camera against the vehicle is taken to be zero.
    """
    turns = matrix_from_quaternion(poses.rotation)
    ways = np.einsum("nji,nj->ni", turns, travel_directions(poses))
    forward = np.median(ways, axis=0)
    # Bends: the middle of a vehicle slips sideways; the directions near the median are those of straight ways.
    off = np.linalg.norm(ways - forward, axis=1)
    forward = ways[off <= np.median(off)].mean(axis=0)
    forward /= np.linalg.norm(forward)
    up = np.array([0.0, -1.0, 0.0])
    up -= (up @ forward) * forward
    up /= np.linalg.norm(up)
    return np.stack([forward, np.cross(up, forward), up])


def mean_up(poses: Poses, ego_R_camera: Float64) -> Float64:
    """Return the mean vertical (3,) of the vehicle in the map of its camera's poses."""
    mean = np.asarray((matrix_from_quaternion(poses.rotation) @ ego_R_camera.T)[:, :, 2].mean(axis=0), np.float64)
    return mean / np.linalg.norm(mean)


def measure_road(poses: Poses, up: Float64, points: Float64) -> RoadHeight | None:
    """Measure the height of a camera above the points of the road that it was driven over.

    The height of a point below the way, where the vehicle passes it, does not depend on the pitch of the vehicle. The
    strip is narrow, so that kerbs and a roll of the camera have no effect.

    Args:
        poses: (N) poses of the camera along its way.
        up: (3,) mean vertical.
        points: (P, 3) points of the map.

    Returns:
        The height; None: there are too few points on the road.
    """
    across, below = _below_way(poses.translation, up, points)
    own = (below > 0.0) & (np.abs(across) < _LANE * below)
    if np.count_nonzero(own) < LEAST_POINTS:
        return None
    logs = np.sort(np.log(below[own]))
    # The densest stretch of heights is the road.
    ends = np.searchsorted(logs, logs + _RIDGE)
    first = int(np.argmax(ends - np.arange(len(logs))))
    height = float(np.median(logs[first : ends[first]]))
    for _ in range(10):
        near = np.abs(logs - height) < 1.5 * _RIDGE
        height = float(np.average(logs[near], weights=1.0 / (1.0 + ((logs[near] - height) / _STEP) ** 2)))
    near = np.abs(logs - height) < 1.5 * _RIDGE
    count = int(np.count_nonzero(near))
    if count < LEAST_POINTS:
        return None
    spread = 1.4826 * float(np.median(np.abs(logs[near] - height)))
    return RoadHeight(float(np.exp(height)), float(np.exp(height) * 1.25 * spread / np.sqrt(count)), count)


def _below_way(places: Float64, up: Float64, points: Float64) -> tuple[Float64, Float64]:
    """Return how far points (Q,) lie left of and below the way where it passes them; the others are left out."""
    way = np.diff(places, axis=0)
    length = np.linalg.norm(way, axis=1)
    keep = length > 1e-9
    starts, way, length = places[:-1][keep], way[keep], length[keep]
    tangent = way / length[:, None]
    upright = up - (tangent @ up)[:, None] * tangent
    upright /= np.linalg.norm(upright, axis=1)[:, None]
    left = np.cross(upright, tangent)
    across, below = [], []
    for chunk in np.array_split(points, max(1, len(points) // 2000)):
        off = chunk[:, None, :] - starts[None]
        along = np.einsum("psi,si->ps", off, tangent)
        beside = (along >= 0.0) & (along <= length)
        distance = np.where(beside, np.linalg.norm(off - along[..., None] * tangent, axis=2), np.inf)
        nearest = distance.argmin(axis=1)
        rows = np.flatnonzero(np.isfinite(distance[np.arange(len(chunk)), nearest]))
        own = nearest[rows]
        across.append(np.einsum("qi,qi->q", off[rows, own], left[own]))
        below.append(-np.einsum("qi,qi->q", off[rows, own], upright[own]))
    return np.concatenate(across), np.concatenate(below)
