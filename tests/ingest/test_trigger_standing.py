"""The ROI trigger where vehicles stand, receivers are noisy or frozen, fixes are missing, and sources give clips."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.recordings.protocol import Track
from tests.ingest.drives import CITY, PLANE
from tests.ingest.passes import run, seconds, straight

# --- standing, noise and gaps -------------------------------------------------------------------------------------


def parked(seconds_: float, noise_m: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0.0, seconds_, 0.1)
    return t, np.random.default_rng(seed).normal(0.0, noise_m, (len(t), 2))


@pytest.mark.parametrize("minutes", [0.5, 60.0])
def test_a_parked_car_with_stated_noise_does_not_drive(minutes: float) -> None:
    t, xy = parked(60.0 * minutes, 0.3)
    track = PLANE.track(t, xy, np.full(len(t), 0.3))
    (one,) = run(track, PLANE.roi())
    assert one.rule == ("min_path" if minutes < 1.0 else "min_duration")
    assert one.path_m < 2.0
    (kept,) = run(track, PLANE.roi(), trim_standstill_s=None)
    assert (kept.rule, kept.path_m < 2.0) == ("min_path", True)
    assert kept.duration_s == pytest.approx(t[-1])


def test_a_parked_car_without_stated_noise_is_held_by_the_half_metre() -> None:
    # Half a metre is five sigmas of 0.1 m noise; noise of 0.3 m that no source states is taken for motion.
    t, xy = parked(50.0, 0.1)
    assert run(PLANE.track(t, xy), PLANE.roi())[0].rule == "min_path"
    t, xy = parked(50.0, 0.3)
    assert run(PLANE.track(t, xy), PLANE.roi())[0].accepted
    assert run(PLANE.track(t, xy), PLANE.roi(), min_step_m=1.8)[0].rule == "min_path"


def test_sigma_that_is_not_a_number_asks_for_the_half_metre() -> None:
    t = np.arange(0.0, 20.1, 0.1)
    xy = np.column_stack([3.0 * t, np.zeros(len(t))])
    for sigma in (np.nan, 0.0, -1.0):
        (one,) = run(PLANE.track(t, xy, np.full(len(t), sigma)), PLANE.roi())
        assert one.path_m == pytest.approx(60.0)
    (one,) = run(PLANE.track(t, xy, np.full(len(t), np.inf)), PLANE.roi())
    assert one.path_m == pytest.approx(60.0)


def test_noise_adds_little_to_the_path_of_a_moving_car() -> None:
    t, noise = parked(30.0, 0.3, seed=4)
    xy = noise + np.column_stack([5.0 * t, np.zeros(len(t))])
    (one,) = run(PLANE.track(t, xy, np.full(len(t), 0.3)), PLANE.roi())
    assert one.path_m == pytest.approx(5.0 * t[-1], rel=0.03)


def stop_and_go(before_s: float, stand_s: float, after_s: float) -> Track:
    """10 m/s, a stand, 10 m/s, with a noise of 2 cm."""
    t = np.arange(0.0, before_s + stand_s + after_s + 1e-9, 0.1)
    x = np.interp(t, [0, before_s, before_s + stand_s, before_s + stand_s + after_s], [0, 10 * before_s] * 2)
    moved = np.clip(t - before_s - stand_s, 0.0, None) * 10.0
    x = np.minimum(t, before_s) * 10.0 + moved
    noise = np.random.default_rng(1).normal(0.0, 0.02, (len(t), 2))
    return PLANE.track(t, noise + np.column_stack([x - 100.0, np.zeros(len(t))]))


@pytest.mark.parametrize(
    ("before", "stand", "after", "kinds"),
    [
        (12.0, 59.0, 12.0, [("recording_edge", "recording_edge")]),
        (12.0, 62.0, 12.0, [("recording_edge", "standstill"), ("standstill", "recording_edge")]),
        (0.0, 62.0, 12.0, [("standstill", "recording_edge")]),
        (12.0, 62.0, 0.0, [("recording_edge", "standstill")]),
        (0.0, 62.0, 0.0, [("recording_edge", "standstill")]),
    ],
    ids=["short", "middle", "start", "end", "nothing else"],
)
def test_long_standstills_are_cut_out(before: float, stand: float, after: float, kinds: list[tuple[str, str]]) -> None:
    found = run(stop_and_go(before, stand, after), PLANE.roi())
    assert [(one.entry_kind, one.exit_kind) for one in found] == kinds
    moving = before > 0.0 or after > 0.0
    assert [one.accepted for one in found] == [moving] * len(kinds)
    if stand > 60.0 and moving:
        assert sum(one.duration_s for one in found) == pytest.approx(before + after, abs=0.25)
        assert all(one.path_m == pytest.approx(120.0, abs=0.7) for one in found)
    (whole,) = run(stop_and_go(before, stand, after), PLANE.roi(), trim_standstill_s=None)
    assert whole.duration_s == pytest.approx(before + stand + after)


def test_a_standing_visit_leaves_an_empty_pass_in_the_ledger() -> None:
    (one,) = run(stop_and_go(0.0, 300.0, 0.0), PLANE.roi())
    assert (one.duration_s, one.rule, one.exit_kind) == (0.0, "min_duration", "standstill")


def test_a_standstill_is_trimmed_up_to_the_crossing() -> None:
    # Stands for 70 s, then leaves the circle.
    track, roi = stop_and_go(0.0, 70.0, 30.0), PLANE.roi(x_m=-100.0, radius_m=150.0)
    (one,) = run(track, roi)
    assert (one.entry_kind, one.exit_kind, one.accepted) == ("standstill", "crossing", True)
    assert one.duration_s == pytest.approx(15.0, abs=0.1)


@pytest.mark.parametrize(("gap_s", "count"), [(1.9, 1), (2.0, 1), (2.1, 2)])
def test_a_gap_ends_a_visit(gap_s: float, count: int) -> None:
    t = np.concatenate([np.arange(0.0, 15.05, 0.1), np.arange(15.0, 30.05, 0.1) + gap_s])
    track = PLANE.track(t, np.column_stack([5.0 * t - 80.0, np.zeros(len(t))]))
    found = run(track, PLANE.roi())
    assert len(found) == count
    if count == 2:
        assert [(one.entry_kind, one.exit_kind) for one in found] == [
            ("recording_edge", "gap"),
            ("gap", "recording_edge"),
        ]
        assert seconds(found[0])[1] == pytest.approx(15.0)
        assert seconds(found[1])[0] == pytest.approx(15.0 + gap_s)
        assert not any(one.split for one in found)


def test_a_restart_ends_a_visit_like_a_gap() -> None:
    t = np.arange(0.0, 40.0, 0.1)
    x = np.where(t < 20.0, 5.0 * t - 100.0, 5.0 * t - 400.0)
    track = PLANE.track(t, np.column_stack([x, np.zeros(len(t))]))
    (first,) = run(track, PLANE.roi(radius_m=120.0))[:1]
    assert (first.exit_kind, first.accepted) == ("gap", True)
    assert first.path_m == pytest.approx(99.5, abs=0.1)


def test_a_frozen_receiver_passes_with_a_longer_gap() -> None:
    # Rows of 1 Hz, a new fix every 13 s, 13 m/s: as in the RSK drives.
    t = np.arange(200.0)
    track = CITY.track(t, np.column_stack([(t // 13) * 169.0 - 1200.0, np.zeros(200)]))
    assert not any(one.accepted for one in run(track, CITY.roi(radius_m=200.0)))
    (one,) = run(track, CITY.roi(radius_m=200.0), max_gap_s=30.0)
    assert one.accepted
    assert one.duration_s == pytest.approx(400.0 / 13.0, abs=0.05)
    assert one.path_m == pytest.approx(400.0, abs=0.1)


def test_a_wrong_first_fix_does_not_hurt() -> None:
    t = np.arange(0.0, 30.0, 0.1)
    xy = np.column_stack([5.0 * t - 75.0, np.zeros(len(t))])
    xy[0] = 90_000.0
    (one,) = run(PLANE.track(t, xy), PLANE.roi())
    assert (one.accepted, one.entry_kind) == (True, "recording_edge")
    assert seconds(one)[0] == pytest.approx(0.1)


# --- clips --------------------------------------------------------------------------------------------------------


def test_a_clip_is_judged_whole() -> None:
    track = straight(PLANE, 10.0, 200.0)
    (one,) = run(track, PLANE.roi(radius_m=100.0), clip=True)
    assert (one.rule, one.measured) == ("min_overlap", pytest.approx(0.5, abs=1e-4))
    assert one.duration_s == pytest.approx(40.0)
    assert run(track, PLANE.roi(radius_m=100.0))[0].accepted
    (inside,) = run(track, PLANE.roi(radius_m=250.0), clip=True)
    assert (inside.accepted, inside.entry_kind, inside.overlap) == (True, "recording_edge", 1.0)
    assert run(track, PLANE.roi(y_m=500.0, radius_m=100.0), clip=True) == []


def test_a_clip_with_gaps_and_stands_stays_one() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(30.0, 140.0, 0.1)])
    x = np.interp(t, [0, 10, 30, 130, 140], [-100.0, -50.0, 0.0, 0.0, 50.0])
    (one,) = run(PLANE.track(t, np.column_stack([x, np.zeros(len(t))])), PLANE.roi(), clip=True)
    assert (one.accepted, one.visits) == (True, 1)
    assert one.path_m == pytest.approx(150.0, abs=1.0)


def test_a_clip_that_leaps_over_the_circle_in_a_gap() -> None:
    t = np.concatenate([np.arange(0.0, 10.0), np.arange(60.0, 70.0)])
    track = PLANE.track(t, np.column_stack([20.0 * t - 700.0, np.zeros(len(t))]))
    (one,) = run(track, PLANE.roi(radius_m=100.0), clip=True)
    assert one.inside_path_m == pytest.approx(200.0, abs=1e-3)
