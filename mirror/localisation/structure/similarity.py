"""Similarities: scale, rotation and shift of a map, and their fit to the positions of a track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion, quaternion_exp, quaternion_from_matrix

LEAST_FIXES: Final = 5
LEAST_WAY_M: Final = 20.0
_TILT_DEG: Final = 2.0
"""1-sigma of the mean of a vehicle's roll and pitch over a drive, against the horizontal: slopes of the road count."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """The map ``x -> scale * turn @ x + shift``.

    Attributes:
        scale: metres per unit of the map.
        turn: (3, 3) rotation.
        shift: (3,) metres.
    """

    scale: float
    turn: Float64
    shift: Float64

    def move(self, points: Float64) -> Float64:
        """Return moved points (N, 3)."""
        return self.scale * points @ self.turn.T + self.shift

    def move_poses(self, poses: Poses) -> Poses:
        """Return moved poses; their rotations stay rotations."""
        turns = self.turn @ matrix_from_quaternion(poses.rotation)
        return Poses(quaternion_from_matrix(turns), self.move(poses.translation))


@dataclass(frozen=True, eq=False)
class TrackFit:
    """A map in the frame of a track.

    Attributes:
        similarity: from the map.
        sigma_percent: 1-sigma of the scale, percent, for errors of the fixes that do not depend on each other.
        distance_m: (N,) horizontal distances of the fixes from the moved map.
    """

    similarity: Similarity
    sigma_percent: float
    distance_m: Float64


def fit_track(
    places: Float64, up: Float64, fixes: Float64, sigma_m: Float64, least_way_m: float = LEAST_WAY_M
) -> TrackFit:
    """Fit a map to the fixes of a track; single wild fixes hardly count (Cauchy's loss).

    Positions on a straight way leave the roll about it open: the map's mean vertical closes it.

    Args:
        places: (N, 3) positions in the map at the times of the fixes.
        up: (3,) mean vertical of the vehicle in the map.
        fixes: (N, 3) positions, metres, z up; z is NaN where a fix has no height.
        sigma_m: (N,) 1-sigma of the fixes; heights have twice of it.
        least_way_m: smallest extent of the fixes.

    Raises:
        UsageError: the fixes are too few, or the way between them is too short, to give a scale.
    """
    from scipy.optimize import least_squares

    way = float(np.linalg.norm(np.diff(fixes[:, :2], axis=0), axis=1).sum()) if len(fixes) else 0.0
    extent = float(np.linalg.norm(np.ptp(fixes[:, :2], axis=0))) if len(fixes) else 0.0
    if len(fixes) < LEAST_FIXES or extent < least_way_m:
        raise UsageError(
            f"{len(fixes)} fixes over {way:.0f} m during the registered images", place="--scale track",
            expected=f"at least {LEAST_FIXES} fixes that are {least_way_m:.0f} m apart",
            remedy="take the scale from elsewhere: --scale height --camera-height-m METRES, or --length-m METRES",
        )  # fmt: skip
    level = rotation_between(up, np.array([0.0, 0.0, 1.0]))
    known = np.isfinite(fixes[:, 2])
    heights = np.where(known, fixes[:, 2], np.median(fixes[known, 2]) if known.any() else 0.0)
    flat = places @ level.T
    start = fit_flat(flat, fixes[:, :2], sigma_m)
    shift = np.array([*start.shift[:2], np.median(heights - start.scale * flat[:, 2])])

    def moved(unknown: Float64) -> Similarity:
        turn = matrix_from_quaternion(quaternion_exp(unknown[None, 1:4]))[0] @ start.turn
        return Similarity(start.scale * float(np.exp(unknown[0])), turn, shift + unknown[4:])

    def residuals(unknown: Float64) -> Float64:
        off = moved(unknown).move(flat) - np.column_stack([fixes[:, :2], heights])
        vertical = np.where(known, off[:, 2] / (2.0 * sigma_m), 0.0)
        if not known.any():
            vertical[:] = unknown[6] / 1.0
        plain = np.column_stack([off[:, :2] / sigma_m[:, None], vertical]).ravel()
        return np.concatenate([plain, unknown[1:3] / np.radians(_TILT_DEG)])

    found = least_squares(residuals, np.zeros(7), loss="cauchy", x_scale="jac")
    similarity = moved(found.x)
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    distance = np.linalg.norm((similarity.move(flat) - fixes)[:, :2], axis=1)
    whole = Similarity(similarity.scale, similarity.turn @ level, similarity.shift)
    return TrackFit(whole, float(100.0 * np.sqrt(covariance[0, 0])), distance)


def fit_flat(places: Float64, fixes: Float64, sigma_m: Float64) -> Similarity:
    """Fit scale, yaw and shift in the plane; weights fall with the distance, so that wild fixes lose theirs.

    Args:
        places: (N, 3) positions, z up.
        fixes: (N, 2) positions that they are moved to.
        sigma_m: (N,) 1-sigma of the fixes.
    """
    weight = sigma_m**-2.0
    similarity = Similarity(1.0, np.eye(3), np.zeros(3))
    one, other = places[:, 0] + 1j * places[:, 1], fixes[:, 0] + 1j * fixes[:, 1]
    for _ in range(20):
        share = weight / weight.sum()
        middle, target = (share * one).sum(), (share * other).sum()
        factor = (share * np.conj(one - middle) * (other - target)).sum() / (share * np.abs(one - middle) ** 2).sum()
        off = np.abs(target + factor * (one - middle) - other)
        weight = sigma_m**-2.0 / (1.0 + (off / np.maximum(sigma_m, 1.4826 * np.median(off))) ** 2)
        turn = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]]) / abs(factor)
        whole = np.eye(3)
        whole[:2, :2] = turn
        moved = target - factor * middle
        similarity = Similarity(float(abs(factor)), whole, np.array([moved.real, moved.imag, 0.0]))
    return similarity


def rotation_between(one: Float64, other: Float64) -> Float64:
    """Return the smallest rotation (3, 3) that turns a unit vector into another."""
    axis = np.cross(one, other)
    sine, cosine = float(np.linalg.norm(axis)), float(one @ other)
    if sine < 1e-12:
        if cosine > 0.0:
            return np.eye(3)
        across = np.cross(one, np.eye(3)[int(np.argmin(np.abs(one)))])
        axis, sine = across, float(np.linalg.norm(across))
        return matrix_from_quaternion(quaternion_exp((np.pi * axis / sine)[None]))[0]
    return matrix_from_quaternion(quaternion_exp((np.arctan2(sine, cosine) * axis / sine)[None]))[0]
