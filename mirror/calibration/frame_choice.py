"""The choice of the frames of a traversal that a calibration is estimated from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion


@dataclass(frozen=True)
class FrameChoice:
    """The rule that chooses frames: a stretch that turns as much as possible, in even steps.

    A step of 1 is ``step_m`` of driving or ``step_deg`` of turning, or a mixture (root of the sum of squares). Longer
    steps average the errors of the recorded positions over a longer way; shorter ones are easier to track.

    Attributes:
        frames: number of frames.
        step_m: distance between neighbouring frames on a straight road.
        step_deg: change of course between neighbouring frames on a bend.
    """

    frames: int = 20
    step_m: float = 3.5
    step_deg: float = 12.0

    def __post_init__(self) -> None:
        if self.frames < 2 or not (self.step_m > 0.0 and self.step_deg > 0.0):
            raise UsageError(f"{self}", expected="at least 2 frames, and steps above 0")


def choose_stretch(poses: Poses, choice: FrameChoice) -> Float64:
    """Return the positions of the chosen frames on a finely sampled way.

    Args:
        poses: (N,) poses of the vehicle along the way, N >= 2, in order of time.
        choice: how many frames, and how far apart.

    Returns:
        (F,) fractional indices into the poses, ascending, F <= ``choice.frames``; of all stretches the one with the
        largest change of course. A way that is shorter than all steps gives fewer frames; a vehicle that does not move
        gives one.
    """
    if len(poses) < 2:
        return np.zeros(len(poses))
    way_m = np.linalg.norm(np.diff(poses.translation, axis=0), axis=1)
    turns = matrix_from_quaternion(poses.rotation)
    course = np.degrees(np.unwrap(np.arctan2(turns[:, 1, 0], turns[:, 0, 0])))
    steps = np.hypot(way_m / choice.step_m, np.diff(course) / choice.step_deg)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    count = int(min(choice.frames, np.floor(along[-1]) + 1))
    starts = np.arange(0.0, along[-1] - (count - 1) + 1e-9, 0.5)
    index = np.arange(len(along), dtype=np.float64)
    # Where the vehicle stands, the way does not grow; its first instant stands for all.
    moving = np.concatenate([[True], np.diff(along) > 0.0])
    turned = [
        np.abs(np.diff(np.interp([start, start + count - 1], along[moving], course[moving])))[0] for start in starts
    ]
    best = starts[int(np.argmax(np.round(turned, 6)))]
    return np.interp(best + np.arange(count), along[moving], index[moving])


def nearest_distinct(wanted_ns: Float64, stamps_ns: Int64) -> Int64:
    """Return the indices (M,) of the stamps nearest to wanted times, ascending, each once."""
    after = np.clip(np.searchsorted(stamps_ns, wanted_ns), 1, max(len(stamps_ns) - 1, 1))
    before = after - 1
    if len(stamps_ns) < 2:
        return np.arange(len(stamps_ns))
    nearer = np.abs(stamps_ns[after] - wanted_ns) < np.abs(stamps_ns[before] - wanted_ns)
    return np.unique(np.where(nearer, after, before))
