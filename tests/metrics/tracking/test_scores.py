"""Scores of tracks against figures computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.metrics.tracking.scores import TrackedBoxes, score_tracks


def frame(track: int, x_m: float) -> TrackedBoxes:
    return TrackedBoxes(np.array([track]), np.array([[x_m, 80.0]]), np.array([[5.0, 0.0]]), np.array([0.5]))


def test_one_switch_in_four_frames() -> None:
    truth = [[frame(3, float(x)) for x in range(4)]]
    found = [[frame(7 if x < 2 else 8, x + 0.5) for x in range(4)]]
    scores = score_tracks(truth, found)
    assert scores.switches == 1
    assert scores.mota == pytest.approx(1 - 1 / 4)
    # One score level, which reaches all recalls.
    assert scores.amota == pytest.approx(1 - 1 / 4)
    # Of four true and four found boxes, the best pair of ids shares two.
    assert scores.idf1 == pytest.approx(2 * 2 / 8)
    assert scores.misses == 0.0
    assert scores.false_per_frame == 0.0
    assert scores.position_error_m == pytest.approx(0.5)


def test_boxes_beyond_the_threshold_are_missed_and_false() -> None:
    truth = [[frame(3, 0.0), frame(3, 1.0)]]
    found = [[frame(7, 0.0), frame(7, 3.5)]]
    scores = score_tracks(truth, found, threshold_m=2.0)
    assert scores.misses == pytest.approx(0.5)
    assert scores.false_per_frame == pytest.approx(0.5)
    assert scores.idf1 == pytest.approx(2 * 1 / 4)


def test_a_single_frame() -> None:
    scores = score_tracks([[frame(3, 0.0)]], [[frame(7, 9.0)]], threshold_m=2.0)
    assert (scores.misses, scores.false_per_frame) == (1.0, 1.0)


def test_frames_must_correspond() -> None:
    with pytest.raises(UsageError, match="different frames"):
        score_tracks([[frame(0, 0.0)]], [[]])
