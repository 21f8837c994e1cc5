"""Compiled kernels of the adjustment: residuals of observations, and normal equations with eliminated points.

A residual is the difference between the direction to a point and the ray of its feature, mapped to pixels by the
derivative of the lens at the feature, plus what a change of the lens adds. To second order in the residual it is the
reprojection error, for every lens model, and it is defined for all points. It has derivatives by the pose of its frame
(rotation about the vehicle's axes, translation in the world), the mounting (rotation about the camera's axes,
translation on the vehicle), the lens (focal length, principal point), the times of the camera where they are unknown,
and the point. Points are eliminated one by one (the Schur complement), so that only the equations of frames, mountings
and times are solved.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from mirror.arrays import Float64, Int64
from mirror.compiled import inner_njit

POSE: Final = 6
MOUNT: Final = 9
TIMES: Final = 3
"""Times of a camera: offset of its clock, readout of the rows downwards, and of the columns rightwards, seconds."""
_OWN: Final = POSE + MOUNT


@numba.njit(cache=True, nogil=True, inline="always")
def _predict(
    turn: Float64,
    place: Float64,
    mount_turn: Float64,
    mount_place: Float64,
    point: Float64,
    in_ego: Float64,
    q: Float64,
) -> None:  # pragma: no cover
    """Write a world point in the ego frame and in the camera frame."""
    for a in range(3):
        in_ego[a] = 0.0
        for b in range(3):
            in_ego[a] += turn[b, a] * (point[b] - place[b])
    for a in range(3):
        q[a] = 0.0
        for b in range(3):
            q[a] += mount_turn[b, a] * (in_ego[b] - mount_place[b])


@numba.njit(cache=True, nogil=True)
def residuals_px(
    image: Int64, frame: Int64, mounting: Int64, ray: Float64, metric: Float64, from_centre: Float64, late: Float64,
    track: Int64, turns: Float64, places: Float64, mount_turns: Float64, mount_places: Float64, lenses: Float64,
    times: Float64, points: Float64,
) -> Float64:  # pragma: no cover  # fmt: skip
    """Return the residuals (M, 2) of observations; see `reduce_equations` for the arguments."""
    out = np.empty((len(image), 2))
    in_ego, q = np.empty(3), np.empty(3)
    for row in range(len(image)):
        number = image[row]
        k = mounting[number]
        _predict(turns[number], places[number], mount_turns[k], mount_places[k], points[track[row]], in_ego, q)
        length = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
        for a in range(2):
            value = lenses[k, 0] * from_centre[row, a] + lenses[k, 1 + a]
            for e in range(late.shape[2]):
                value += late[row, a, e] * times[k, e]
            for b in range(3):
                value += metric[row, a, b] * (q[b] / length - ray[row, b])
            out[row, a] = value
    return out


@numba.njit(cache=True, nogil=True)
def reduce_equations(
    starts: Int64, image: Int64, frame: Int64, mounting: Int64, ray: Float64, metric: Float64, from_centre: Float64,
    late: Float64, sigma_px: Float64, turns: Float64, places: Float64, mount_turns: Float64, mount_places: Float64,
    lenses: Float64, times: Float64, points: Float64, frames: int, damping: float,
) -> tuple[Float64, Float64, Float64, Float64, Float64, Float64, Float64]:  # pragma: no cover  # fmt: skip
    """Return the normal equations of frames, mountings and times, after elimination of the points.

    Args:
        starts: (T + 1,) first observation of each point.
        image: (M,) image of each observation.
        frame: (I,) frame of each image.
        mounting: (I,) mounting of each image.
        ray: (M, 3) unit rays of the features.
        metric: (M, 2, 3) derivatives of pixels by rays.
        from_centre: (M, 2) features relative to the principal points.
        late: (M, 2, E) derivatives of the residuals by the times of the camera; E is 3, or 0: the times are exact.
        sigma_px: (M,) scales of Cauchy's loss.
        turns: (I, 3, 3) rotations world_R_ego of the images.
        places: (I, 3) positions of the vehicle.
        mount_turns: (K, 3, 3) rotations ego_R_camera.
        mount_places: (K, 3) positions of the cameras on the vehicle.
        lenses: (K, 3) changes of the logarithm of the focal length, and of the principal point in pixels.
        times: (K, 3) times of the cameras since `late` was computed, seconds.
        points: (T, 3) points.
        frames: number of frames.
        damping: Levenberg's factor of the points' own blocks.

    Returns:
        Reduced matrix (N, N) with N = 6 frames + (9 + E) mountings, the times last of all, the diagonal (N,) before
        elimination, the reduced gradient (N,), the sum (N, N) of the outer products of the points' reduced gradients,
        and for `step_points` the inverse blocks (T, 3, 3) of the points, the mixed blocks (M, 15 + E, 3) and the
        points' gradients (T, 3).
    """
    extra = late.shape[2]
    count_own, first_time = _OWN + extra, POSE * frames + MOUNT * len(mount_places)
    size = first_time + extra * len(mount_places)
    matrix, diagonal, gradient = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    scatter = np.zeros((size, size))
    inverses, slopes = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    mixed = np.zeros((len(image), count_own, 3))
    own = np.zeros((size, 3))
    score = np.zeros(size)
    seen = np.zeros(size, np.bool_)
    touched = np.empty(size, np.int64)
    in_ego, q, d = np.empty(3), np.empty(3), np.empty(3)
    by_q, by_ego, by_world = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    j, r = np.empty((2, count_own)), np.empty(2)
    columns = np.empty(count_own, np.int64)
    for t in range(len(points)):
        block, slope, count = np.zeros((3, 3)), np.zeros(3), 0
        for row in range(starts[t], starts[t + 1]):
            number = image[row]
            k = mounting[number]
            turn, mount_turn = turns[number], mount_turns[k]
            _predict(turn, places[number], mount_turn, mount_places[k], points[t], in_ego, q)
            length = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
            for a in range(3):
                d[a] = q[a] / length
            for a in range(2):
                r[a] = lenses[k, 0] * from_centre[row, a] + lenses[k, 1 + a]
                for e in range(extra):
                    j[a, _OWN + e] = late[row, a, e]
                    r[a] += late[row, a, e] * times[k, e]
                along = 0.0
                for b in range(3):
                    r[a] += metric[row, a, b] * (d[b] - ray[row, b])
                    along += metric[row, a, b] * d[b]
                for b in range(3):
                    by_q[a, b] = (metric[row, a, b] - along * d[b]) / length
                for b in range(3):
                    by_ego[a, b] = 0.0
                    for c in range(3):
                        by_ego[a, b] += by_q[a, c] * mount_turn[b, c]
                for b in range(3):
                    by_world[a, b] = 0.0
                    for c in range(3):
                        by_world[a, b] += by_ego[a, c] * turn[b, c]
                # A rotation of the frame by w moves a point p of it by p x w.
                j[a, 0] = by_ego[a, 1] * in_ego[2] - by_ego[a, 2] * in_ego[1]
                j[a, 1] = by_ego[a, 2] * in_ego[0] - by_ego[a, 0] * in_ego[2]
                j[a, 2] = by_ego[a, 0] * in_ego[1] - by_ego[a, 1] * in_ego[0]
                j[a, 6] = by_q[a, 1] * q[2] - by_q[a, 2] * q[1]
                j[a, 7] = by_q[a, 2] * q[0] - by_q[a, 0] * q[2]
                j[a, 8] = by_q[a, 0] * q[1] - by_q[a, 1] * q[0]
                for b in range(3):
                    j[a, 3 + b] = -by_world[a, b]
                    j[a, 9 + b] = -by_ego[a, b]
                j[a, 12] = from_centre[row, a]
                j[a, 13] = 1.0 - a
                j[a, 14] = float(a)
            square = (r[0] ** 2 + r[1] ** 2) / sigma_px[row] ** 2
            weight = 1.0 / (1.0 + square) / sigma_px[row] ** 2
            for c in range(POSE):
                columns[c] = POSE * frame[number] + c
            for c in range(MOUNT):
                columns[POSE + c] = POSE * frames + MOUNT * k + c
            for e in range(extra):
                columns[_OWN + e] = first_time + extra * k + e
            for b in range(count_own):
                at = columns[b]
                if not seen[at]:
                    seen[at], touched[count] = True, at
                    count += 1
                score[at] += weight * (j[0, b] * r[0] + j[1, b] * r[1])
                for c in range(count_own):
                    matrix[at, columns[c]] += weight * (j[0, b] * j[0, c] + j[1, b] * j[1, c])
                diagonal[at] += weight * (j[0, b] ** 2 + j[1, b] ** 2)
                for c in range(3):
                    value = weight * (j[0, b] * by_world[0, c] + j[1, b] * by_world[1, c])
                    own[at, c] += value
                    mixed[row, b, c] = value
            for b in range(3):
                slope[b] += weight * (by_world[0, b] * r[0] + by_world[1, b] * r[1])
                for c in range(3):
                    block[b, c] += weight * (by_world[0, b] * by_world[0, c] + by_world[1, b] * by_world[1, c])
        _invert(block, damping, inverses[t])
        slopes[t] = slope
        inverse = inverses[t]
        for one in range(count):
            a = touched[one]
            w0 = own[a, 0] * inverse[0, 0] + own[a, 1] * inverse[1, 0] + own[a, 2] * inverse[2, 0]
            w1 = own[a, 0] * inverse[0, 1] + own[a, 1] * inverse[1, 1] + own[a, 2] * inverse[2, 1]
            w2 = own[a, 0] * inverse[0, 2] + own[a, 1] * inverse[1, 2] + own[a, 2] * inverse[2, 2]
            score[a] -= w0 * slope[0] + w1 * slope[1] + w2 * slope[2]
            for other in range(count):
                b = touched[other]
                matrix[a, b] -= w0 * own[b, 0] + w1 * own[b, 1] + w2 * own[b, 2]
        for one in range(count):
            a = touched[one]
            gradient[a] += score[a]
            for other in range(count):
                scatter[a, touched[other]] += score[a] * score[touched[other]]
        for one in range(count):
            a = touched[one]
            own[a, 0], own[a, 1], own[a, 2], score[a], seen[a] = 0.0, 0.0, 0.0, 0.0, False
    return matrix, diagonal, gradient, scatter, inverses, mixed, slopes


@inner_njit
def _invert(block: Float64, damping: float, out: Float64) -> None:  # pragma: no cover
    """Invert a damped symmetric matrix (3, 3); a small share of its trace keeps far points solvable."""
    trace = block[0, 0] + block[1, 1] + block[2, 2]
    a = block.copy()
    for b in range(3):
        a[b, b] += damping * block[b, b] + 1e-12 * trace + 1e-300
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if not determinant > 0.0:
        out[:] = 0.0
        return
    out[0, 0], out[0, 1], out[0, 2] = c00, c01, c02
    out[1, 0], out[1, 1] = c01, a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]
    out[1, 2] = a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]
    out[2, 0], out[2, 1], out[2, 2] = c02, out[1, 2], a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    out /= determinant


@numba.njit(cache=True, nogil=True)
def step_points(
    starts: Int64, image: Int64, frame: Int64, mounting: Int64, inverses: Float64, mixed: Float64, slopes: Float64,
    step: Float64, frames: int, mountings: int,
) -> Float64:  # pragma: no cover  # fmt: skip
    """Compute the steps (T, 3) of the points that follow from a step (N,) of the frames, mountings and times."""
    extra, first_time = mixed.shape[1] - _OWN, POSE * frames + MOUNT * mountings
    out = np.empty((len(inverses), 3))
    for t in range(len(inverses)):
        total = slopes[t].copy()
        for row in range(starts[t], starts[t + 1]):
            number = image[row]
            for b in range(mixed.shape[1]):
                if b < POSE:
                    at = POSE * frame[number] + b
                elif b < _OWN:
                    at = POSE * (frames - 1) + MOUNT * mounting[number] + b
                else:
                    at = first_time + extra * mounting[number] + b - _OWN
                for c in range(3):
                    total[c] += mixed[row, b, c] * step[at]
        for b in range(3):
            out[t, b] = -(inverses[t, b, 0] * total[0] + inverses[t, b, 1] * total[1] + inverses[t, b, 2] * total[2])
    return out
