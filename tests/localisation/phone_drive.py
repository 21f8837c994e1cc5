"""A drive with a phone behind the windscreen."""

from __future__ import annotations

import numpy as np

from mirror.geometry import Poses, quaternion_from_heading_pitch_roll
from tests.calibration.corridor import NOMINAL

START_NS, STEP_NS = 1_772_359_200_000_000_000, 100_000_000

IMAGES = 14


def drive(count: int = IMAGES) -> Poses:
    """The vehicle's poses: 0.8 m a step, in a gentle bend to the left, with a little pitch."""
    yaw = np.radians(0.4) * np.arange(count)
    places = np.cumsum(0.8 * np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(count)]), axis=0)
    heading = 90.0 - np.degrees(yaw)
    pitch = 0.2 * np.sin(np.arange(count))
    return Poses(quaternion_from_heading_pitch_roll(heading, pitch, np.zeros(count)), places)


def mounted(ego: Poses) -> Poses:
    return ego @ NOMINAL[np.zeros(len(ego), np.int64)]
