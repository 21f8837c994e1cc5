"""How far along its recorded line a road user is: from this follows the phase of a walk.

A request places road users at one instant and has no memory of others. So that a pedestrian who is placed along a line,
instant after instant, makes steps as in a rollout, the distance that it has travelled is a function of its place alone:
the length of the recorded line up to the nearest point of it, and from there on the distance along the heading.
"""

from __future__ import annotations

import math

import numpy as np

from hybridworldsim.simulator.agents.replay import RecordedTrack
from mirror.arrays import Float64


class RecordedLine:
    """The line of a recorded road user.

    Args:
        track: its recorded track.
    """

    def __init__(self, track: RecordedTrack) -> None:
        points = track.poses[:, :2]
        steps = np.diff(points, axis=0)
        length = np.hypot(steps[:, 0], steps[:, 1])
        moving = length > 0.0
        self._begin = points[:-1][moving] if moving.any() else points[:1]
        self._step = steps[moving] if moving.any() else np.zeros((1, 2))
        self._length = length[moving] if moving.any() else np.ones(1)
        self._speed = length[moving] / np.diff(track.times_s)[moving] if moving.any() else np.zeros(1)
        self._along = np.concatenate([[0.0], np.cumsum(self._length)[:-1]])

    def at(self, place: Float64) -> tuple[float, float]:
        """Return the travelled distance and the recorded speed at a place.

        Args:
            place: (3,) x, y and yaw in the world. If the heading is against the line, the distance decreases along the
                line, so that nobody walks backwards.
        """
        x, y, yaw = place.tolist()
        gap = np.array([x, y]) - self._begin
        share = np.clip((gap * self._step).sum(axis=1) / self._length**2, 0.0, 1.0)
        rest = gap - share[:, None] * self._step
        nearest = int((rest**2).sum(axis=1).argmin())
        heading = np.array([math.cos(yaw), math.sin(yaw)])
        direction = math.copysign(1.0, float(self._step[nearest] @ heading))
        on_line = float(self._along[nearest] + share[nearest] * self._length[nearest])
        if not self._step[nearest].any():
            on_line = 0.0
        return direction * on_line + float(rest[nearest] @ heading), float(self._speed[nearest])
