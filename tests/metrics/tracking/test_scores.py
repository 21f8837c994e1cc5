"""Scores of tracks against figures computed by hand."""

from __future__ import annotations

import itertools

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


def boxes(tracks: list[int], place_m: np.ndarray) -> TrackedBoxes:
    count = len(tracks)
    place_m = np.asarray(place_m, np.float64).reshape(count, 2)
    return TrackedBoxes(np.array(tracks, np.int64), place_m, np.full((count, 2), np.nan), np.ones(count))


def test_a_pair_that_is_still_near_is_kept_though_breaking_it_gains_one() -> None:
    # Object 0 has track 11, 1 m away. Object 1 is near 11 alone, track 12 is near object 0 alone.
    truth = [[boxes([0], [[0.0, 0.0]]), boxes([0, 1], [[0.0, 0.0], [2.5, 0.0]])]]
    found = [[boxes([11], [[0.0, 0.0]]), boxes([11, 12], [[1.0, 0.0], [-1.5, 0.0]])]]
    scores = score_tracks(truth, found, threshold_m=2.0)
    assert scores.switches == 0
    assert scores.misses == pytest.approx(1 / 3)
    assert scores.false_per_frame == pytest.approx(1 / 2)
    assert scores.mota == pytest.approx(1 - 2 / 3)
    assert scores.position_error_m == pytest.approx(1.0 / 2)


def test_of_two_objects_that_had_a_track_the_nearest_keeps_it() -> None:
    # Object 1 gets track 11 while object 0 is away; then both are near it, and object 0 is listed first.
    truth = [[boxes([0], [[0.0, 0.0]]), boxes([1], [[1.0, 0.0]]), boxes([0, 1], [[0.0, 0.0], [1.0, 0.0]])]]
    found = [[boxes([11], [[0.0, 0.0]]), boxes([11], [[1.0, 0.0]]), boxes([11, 12], [[0.8, 0.0], [0.2, 0.0]])]]
    scores = score_tracks(truth, found, threshold_m=2.0)
    assert (scores.switches, scores.misses) == (1, 0.0)
    assert scores.position_error_m == pytest.approx((0.0 + 0.0 + 0.2 + 0.2) / 4)


def clear_mot(truth: list[TrackedBoxes], found: list[TrackedBoxes], threshold_m: float) -> tuple[int, int, int]:
    """Switches, misses and false boxes by the text of Bernardin and Stiefelhagen, one box after another."""
    mapped: dict[int, int] = {}
    switches = misses = extra = 0
    for real, given in zip(truth, found):
        places = {int(track): place for track, place in zip(given.track, given.position_m)}
        objects = {int(name): place for name, place in zip(real.track, real.position_m)}
        distance = {(n, t): float(np.hypot(*(objects[n] - places[t]))) for n in objects for t in places}
        lasting = sorted((distance[pair], pair) for pair in mapped.items() if distance.get(pair, np.inf) <= threshold_m)
        pairs: dict[int, int] = {}
        for _, (name, track) in lasting:
            if track not in pairs.values():
                pairs[name] = track
        names = [name for name in objects if name not in pairs]
        tracks = [track for track in places if track not in pairs.values()]
        best: tuple[int, float, tuple[tuple[int, int], ...]] = (0, 0.0, ())
        # All ways to give each object a track or none.
        for chosen in itertools.permutations([*tracks, *([None] * len(names))], len(names)):
            new = tuple((name, track) for name, track in zip(names, chosen) if track is not None)
            if all(distance[pair] <= threshold_m for pair in new):
                best = min(best, (-len(new), sum(distance[pair] for pair in new), new))
        for name, track in best[2]:
            switches += mapped.get(name, track) != track
            pairs[name] = track
        mapped.update(pairs)
        misses += len(objects) - len(pairs)
        extra += len(places) - len(pairs)
    return switches, misses, extra


def test_crowds_are_counted_as_by_the_definition() -> None:
    rng = np.random.default_rng(0)
    for _ in range(12):
        places, speeds = rng.uniform(0.0, 5.0, (4, 2)), rng.normal(0.0, 0.3, (4, 2))
        truth, found = [], []
        for step in range(12):
            seen = np.flatnonzero(rng.random(4) > 0.2)
            noisy = (places + step * speeds)[seen] + rng.normal(0.0, 0.7, (len(seen), 2))
            truth.append(boxes([0, 1, 2, 3], places + step * speeds))
            found.append(boxes([10 + int(name) for name in seen], noisy))
        switches, misses, extra = clear_mot(truth, found, 2.0)
        scores = score_tracks([truth], [found], threshold_m=2.0)
        assert scores.switches == switches
        assert scores.misses == pytest.approx(misses / 48)
        assert scores.false_per_frame == pytest.approx(extra / 12)


def test_a_single_frame() -> None:
    scores = score_tracks([[frame(3, 0.0)]], [[frame(7, 9.0)]], threshold_m=2.0)
    assert (scores.misses, scores.false_per_frame) == (1.0, 1.0)


def test_frames_must_correspond() -> None:
    with pytest.raises(UsageError, match="different frames"):
        score_tracks([[frame(0, 0.0)]], [[]])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"track": np.array([1, -1, 3])}, "row 1"),
        ({"track": np.array([1, 3, 3])}, "row 2"),
        ({"track": np.array([1.0, 2.0, 3.0])}, "track of type float64"),
        ({"position_m": np.array([[0.0, 0.0], [1.0, 0.0], [np.nan, 0.0]])}, "row 2"),
        ({"position_m": np.zeros((3, 3))}, r"position_m of shape \(3, 3\)"),
        ({"velocity_mps": np.array([[np.inf, 0.0], [0.0, 0.0], [0.0, 0.0]])}, "row 0"),
        ({"velocity_mps": np.zeros((2, 2))}, "velocity_mps of shape"),
        ({"score": np.array([1.0, np.nan, 1.0])}, "row 1"),
        ({"score": np.ones((3, 1))}, "score of shape"),
    ],
)
def test_boxes_that_are_none_are_refused(changed: dict[str, np.ndarray], message: str) -> None:
    given = {
        "track": np.array([1, 2, 3]),
        "position_m": np.zeros((3, 2)),
        "velocity_mps": np.full((3, 2), np.nan),
        "score": np.array([0.0, -3.0, 1.0]),
    }
    assert TrackedBoxes(**given).track.tolist() == [1, 2, 3]
    with pytest.raises(UsageError, match=message) as caught:
        TrackedBoxes(**{**given, **changed})
    assert next(iter(changed)) in str(caught.value)
