"""Which boxes are of one object: a Kalman filter of constant velocity in the world frame, and Hungarian matching.

A. Bewley et al., Simple online and realtime tracking, ICIP 2016, with real times between frames and with distances in
standard deviations of the prediction. The filters of all tracks are one batch of arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from mirror.annotation.tracking.options import ACCELERATION_MPS2, BoxTrackingOptions
from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.installation import install_command

_INITIAL_SPEED_MPS = {"vehicle": 8.0, "two_wheeler": 5.0, "pedestrian": 1.5, "static": 0.1}


@dataclass(frozen=True, eq=False)
class WorldBoxes:
    """The N boxes of one frame in the world frame.

    Attributes:
        time_s: time of the frame since the first one.
        centre_m: (N, 3).
        yaw_rad: (N,) heading about the vertical.
        size_m: (N, 3).
        sigma_m: (N,) standard deviation of the position along each horizontal axis.
        score: (N,) from 0 to 1; a label without one counts as 1.
        category: N names.
        group: N groups, see `group_of`.
    """

    time_s: float
    centre_m: Float64
    yaw_rad: Float64
    size_m: Float64
    sigma_m: Float64
    score: Float64
    category: tuple[str, ...]
    group: tuple[str, ...]


@dataclass
class Tracklet:
    """One object: the frames in which it has a box.

    Attributes:
        group: group of its categories.
        frames: numbers of the frames, ascending.
        boxes: its box in each of these frames.
    """

    group: str
    frames: list[int] = field(default_factory=list)
    boxes: list[int] = field(default_factory=list)


class _Filters:
    """Kalman filters of the living tracks: states (T, 4) ``x y vx vy`` and covariances (T, 4, 4)."""

    def __init__(self) -> None:
        self.state, self.covariance = np.empty((0, 4)), np.empty((0, 4, 4))
        self.acceleration = np.empty(0)

    def predict(self, dt: float) -> None:
        """Advance all filters."""
        step = np.eye(4)
        step[0, 2] = step[1, 3] = dt
        self.state = self.state @ step.T
        noise = np.zeros((len(self.state), 4, 4))
        variance = self.acceleration**2
        for axis in (0, 1):
            noise[:, axis, axis] = variance * (dt**3 / 3.0)
            noise[:, axis, axis + 2] = noise[:, axis + 2, axis] = variance * (0.5 * dt**2)
            noise[:, axis + 2, axis + 2] = variance * dt
        self.covariance = step @ self.covariance @ step.T + noise

    def update(self, rows: Int64, position: Float64, sigma: Float64) -> None:
        """Add measured positions (K, 2) with standard deviations (K,)."""
        covariance = self.covariance[rows]
        innovation = covariance[:, :2, :2] + (sigma**2)[:, None, None] * np.eye(2)
        gain = covariance[:, :, :2] @ np.linalg.inv(innovation)
        self.state[rows] += np.einsum("kij,kj->ki", gain, position - self.state[rows, :2])
        self.covariance[rows] = covariance - gain @ covariance[:, :2, :]

    def add(self, position: Float64, sigma: Float64, groups: Sequence[str]) -> None:
        """Begin filters at positions (K, 2)."""
        count = len(position)
        self.state = np.concatenate((self.state, np.hstack((position, np.zeros((count, 2))))))
        covariance = np.zeros((count, 4, 4))
        speed = np.array([_INITIAL_SPEED_MPS[group] for group in groups])
        for axis in (0, 1):
            covariance[:, axis, axis], covariance[:, axis + 2, axis + 2] = sigma**2, speed**2
        self.covariance = np.concatenate((self.covariance, covariance))
        more = np.array([ACCELERATION_MPS2[group] for group in groups])
        self.acceleration = np.concatenate((self.acceleration, more))

    def keep(self, rows: Bool) -> None:
        """Drop the other filters."""
        self.state, self.covariance, self.acceleration = (
            self.state[rows],
            self.covariance[rows],
            self.acceleration[rows],
        )


def associate(frames: Sequence[WorldBoxes], options: BoxTrackingOptions) -> list[Tracklet]:
    """Match the boxes of consecutive frames.

    Args:
        frames: boxes of each frame, in order of time.
        options: gates, and how long a track lives without a box.

    Returns:
        All tracklets, also those of a single box, in order of their first box.
    """
    done: list[Tracklet] = []
    living: list[Tracklet] = []
    seen_s: list[float] = []
    filters = _Filters()
    time_s = 0.0
    for number, boxes in enumerate(frames):
        if living:
            filters.predict(boxes.time_s - time_s)
            alive = boxes.time_s - np.array(seen_s) <= options.max_gap_s
            living = [track for track, keep in zip(living, alive) if keep]
            seen_s = [stamp for stamp, keep in zip(seen_s, alive) if keep]
            filters.keep(alive)
        time_s = boxes.time_s
        tracks, found = _match(filters, living, boxes, options)
        if len(tracks):
            filters.update(tracks, boxes.centre_m[found, :2], boxes.sigma_m[found])
        for track, box in zip(tracks.tolist(), found.tolist()):
            living[track].frames.append(number)
            living[track].boxes.append(box)
            seen_s[track] = boxes.time_s
        free = np.setdiff1d(np.flatnonzero(boxes.score >= options.birth_score), found)
        if len(free):
            groups = [boxes.group[box] for box in free]
            filters.add(boxes.centre_m[free, :2], boxes.sigma_m[free], groups)
            born = [Tracklet(group, [number], [box]) for group, box in zip(groups, free.tolist())]
            living += born
            done += born
            seen_s += [boxes.time_s] * len(born)
    return done


def _assignment() -> Callable[[Float64], tuple[Int64, Int64]]:
    try:
        from scipy.optimize import linear_sum_assignment
    except ModuleNotFoundError as error:
        raise UsageError("tracking needs scipy", remedy=install_command("models")) from error
    solve: Callable[[Float64], tuple[Int64, Int64]] = linear_sum_assignment
    return solve


def _match(
    filters: _Filters, living: Sequence[Tracklet], boxes: WorldBoxes, options: BoxTrackingOptions
) -> tuple[Int64, Int64]:
    """Rows of the tracks and of the boxes that belong together; the sum of squared distances is least."""
    nothing = np.empty(0, np.int64)
    if not living or not len(boxes.score):
        return nothing, nothing
    linear_sum_assignment = _assignment()
    offset = boxes.centre_m[None, :, :2] - filters.state[:, None, :2]
    innovation = filters.covariance[:, None, :2, :2] + (boxes.sigma_m**2)[None, :, None, None] * np.eye(2)
    a, b, d = innovation[..., 0, 0], innovation[..., 0, 1], innovation[..., 1, 1]
    x, y = offset[..., 0], offset[..., 1]
    determinant = a * d - b * b
    squared = (d * x * x - 2.0 * b * x * y + a * y * y) / determinant
    same = np.array([[track.group == group for group in boxes.group] for track in living])
    allowed = same & (squared <= options.gate_sigmas**2) & (np.hypot(x, y) <= options.gate_m)
    # The likelihood also counts the spread: a wide prediction must not take the boxes of a narrow one. Not to match
    # costs more than any allowed pair, so that as many pairs as possible are made.
    cost = squared + np.log(determinant)
    worst = options.gate_sigmas**2 + float(np.log(determinant).max()) - float(cost.min()) + 1.0
    rows, columns = linear_sum_assignment(np.where(allowed, cost - cost.min(), worst * 1e3))
    valid = allowed[rows, columns]
    return rows[valid], columns[valid]
