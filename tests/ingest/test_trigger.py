"""The ROI trigger in cases whose answer is known in closed form, at its boundaries, and on real drives."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from mirror.geometry.geodesy import utm_to_geodetic
from mirror.ingest.clean import clean
from mirror.ingest.trigger import Pass, Trigger
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions
from tests.ingest import reference
from tests.ingest.drives import ANTIMERIDIAN, ARCTIC, CITY, FAR_PLANE, PLACES, PLANE, T0_NS, Driver, Place
from tests.ingest.test_clean import rsk_track

FAST = CleaningOptions(max_speed_mps=400.0, max_acceleration_mps2=200.0)


def run(
    track: Track,
    rois: Roi | list[Roi],
    *,
    clip: bool = False,
    cleaning: CleaningOptions | None = None,
    **options: object,
) -> list[Pass]:
    cleaning, chosen = cleaning or CleaningOptions(), TriggerOptions(**options)
    listed = rois if isinstance(rois, list) else [rois]
    cleaned, _ = clean(track, cleaning, min_step_m=chosen.min_step_m)
    return Trigger(listed, chosen, cleaning).passes(cleaned, frame=listed[0].frame if listed else None, is_clip=clip)


def straight(
    place: Place, speed: float, half_m: float, *, hz: float = 10.0, y_m: float = 0.0, phase: float = 0.0
) -> Track:
    """East along y from x = -half to half; at x = 0 the time is half / speed."""
    t = np.arange(0.0, 2.0 * half_m / speed + 1e-9, 1.0 / hz) + phase
    return place.track(t, np.column_stack([t * speed - half_m, np.full(len(t), y_m)]))


def seconds(one: Pass) -> tuple[float, float]:
    return (one.entry_ns - T0_NS) * 1e-9, (one.exit_ns - T0_NS) * 1e-9


# --- geometry of a visit -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [PLANE, FAR_PLANE], ids=["plane", "offset of 1e6 m"])
def test_straight_through_the_centre(place: Place) -> None:
    (one,) = run(straight(place, 10.0, 400.0, phase=0.013), place.roi(radius_m=200.0))
    assert one.accepted
    assert seconds(one) == pytest.approx((20.0, 60.0), abs=2e-7)
    assert (one.entry_kind, one.exit_kind) == ("crossing", "crossing")
    assert (one.path_m, one.inside_path_m, one.duration_s) == pytest.approx((400.0, 400.0, 40.0), abs=1e-6)
    assert (one.overlap, one.visits, one.split, one.poses) == (1.0, 1, False, 400)
    assert one.closest_m == pytest.approx(0.0, abs=1e-6)
    assert (one.heading_in_deg, one.heading_out_deg) == pytest.approx((90.0, 90.0))
    assert one.entry == pytest.approx((place.offset_m - 200.0, -place.offset_m), abs=2e-6)


def test_a_chord_off_the_centre() -> None:
    (one,) = run(straight(PLANE, 8.0, 400.0, hz=1.0, y_m=120.0), PLANE.roi(radius_m=200.0))
    assert seconds(one) == pytest.approx((30.0, 70.0), abs=1e-6)
    assert one.closest_m == pytest.approx(120.0, abs=1e-9)


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_in_and_out_within_one_step(place: Place) -> None:
    # 20 m/s at 1 Hz with fixes at x = -10 and 10: the circle of 5 m is touched between two fixes only.
    t = np.arange(-20.0, 20.0)
    track = place.track(t, np.column_stack([(t + 0.5) * 20.0, np.full(len(t), 3.0)]))
    (one,) = run(track, place.roi(radius_m=5.0))
    assert seconds(one) == pytest.approx((-0.7, -0.3), abs=1e-3)
    assert (one.poses, one.rule) == (0, "min_duration")
    assert one.closest_m == pytest.approx(3.0, abs=1e-3)
    # The line touches at 4.999 m, and does not at 5.001 m.
    for y_m, count in ((4.999, 1), (5.001, 0)):
        track = place.track(t, np.column_stack([(t + 0.5) * 20.0, np.full(len(t), y_m)]))
        assert len(run(track, place.roi(radius_m=5.0))) == count


@pytest.mark.parametrize("place", [place for place in PLACES.values() if place.frame is None], ids=str)
@pytest.mark.parametrize(("radius_m", "speed", "hz"), [(1.0, 2.0, 10.0), (200.0, 13.0, 10.0), (20_000.0, 65.0, 1.0)])
def test_crossings_lie_on_the_geodesic_circle(place: Place, radius_m: float, speed: float, hz: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(3):
        angle, aside = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.9, 0.9) * radius_m
        along = np.arange(-1.3 * radius_m, 1.3 * radius_m, speed / hz)
        xy = np.column_stack([along, np.full(len(along), aside)]) @ [
            [math.cos(angle), math.sin(angle)],
            [-math.sin(angle), math.cos(angle)],
        ]
        track, roi = place.track(np.arange(len(along)) / hz, xy), place.roi(radius_m=radius_m)
        found = run(track, roi, trim_standstill_s=None)
        surface, fixes = reference.Globe(), reference.cleaned(track, CleaningOptions())
        centre = reference.centre_of(roi)
        expected = reference.find_visits(surface, fixes, centre, radius_m, 2_000_000_000)
        assert len(found) == len(expected) == 1
        one, visit = found[0], expected[0]
        for t, t_ref, p in ((one.entry_ns, visit.t0, one.entry), (one.exit_ns, visit.t1, one.exit)):
            assert abs(surface.distance(p, centre) - radius_m) < 1e-3
            if reference.radial_speed(surface, fixes, t_ref, centre) >= 1.0:
                assert abs(t - t_ref) < 1_000_000
        assert one.closest_m == pytest.approx(visit.closest, rel=1e-6, abs=1e-3)


def test_a_circle_round_the_pole_is_found() -> None:
    roi = Roi(scene_id="north", longitude_deg=10.0, latitude_deg=89.9, radius_m=20_000.0)
    t = np.arange(3000.0)
    lon = (np.linspace(-180.0, 180.0, len(t)) * 3.0 + 180.0) % 360.0 - 180.0
    track = Track(timestamp_ns=t.astype(np.int64) * 10**9, longitude_deg=lon, latitude_deg=np.full(len(t), 89.95))
    found = run(track, roi)
    expected = reference.passes(track, [roi])
    assert [one.entry_ns for one in found] == [one.entry_ns for one in expected]
    assert [one.rule for one in found] == [one.rule for one in expected]


def test_wrapped_entry_coordinates() -> None:
    (one,) = run(straight(ANTIMERIDIAN, 10.0, 400.0), ANTIMERIDIAN.roi(x_m=200.0, radius_m=200.0))
    assert one.accepted
    assert abs(abs(one.entry[0]) - 180.0) < 1e-4
    assert all(abs(lon) <= 180.0 for lon, _ in (one.entry, one.exit))


def test_the_edge_of_the_circle_is_inside() -> None:
    t = np.arange(31.0)
    on_the_edge = PLANE.track(t, np.column_stack([np.full(31, 200.0), np.zeros(31)]))
    (one,) = run(on_the_edge, PLANE.roi(radius_m=200.0))
    assert (one.entry_kind, one.exit_kind, one.duration_s) == ("recording_edge", "recording_edge", 30.0)
    beyond = PLANE.track(t, np.column_stack([np.full(31, math.nextafter(200.0, 300.0)), np.zeros(31)]))
    assert run(beyond, PLANE.roi(radius_m=200.0)) == []


# --- the paper's thresholds ---------------------------------------------------------------------------------------


def test_exactly_ten_seconds_and_a_nanosecond_less() -> None:
    t = np.arange(0.0, 10.01, 0.1)
    track = PLANE.track(t, np.column_stack([3.0 * t, np.zeros(len(t))]))
    (one,) = run(track, PLANE.roi())
    assert (one.duration_s, one.rule) == (10.0, None)
    stamps = track.timestamp_ns.copy()
    stamps[-1] -= 1
    (one,) = run(Track(timestamp_ns=stamps, x_m=track.x_m, y_m=track.y_m), PLANE.roi())
    assert (one.rule, one.measured, one.threshold) == ("min_duration", (10**10 - 1) / 1e9, 10.0)


def test_exactly_twenty_metres_and_a_little_less() -> None:
    t = np.arange(0.0, 20.5)
    for length, rule in ((20.0, None), (20.0 - 1e-6, "min_path")):
        x = np.minimum(t, length)
        (one,) = run(PLANE.track(t, np.column_stack([x, np.zeros(len(t))])), PLANE.roi())
        assert one.path_m == pytest.approx(length, abs=1e-12)
        assert one.rule == rule


def test_exactly_ninety_percent_is_not_more_than_ninety() -> None:
    # A clip of 100 m of which the last 10 lie outside; 89 or 91 with the circle moved by a metre.
    t = np.arange(0.0, 20.1, 0.5)
    track = PLANE.track(t, np.column_stack([t * 5.0 - 90.0, np.zeros(len(t))]))
    for shift, rule in ((0.0, "min_overlap"), (-1.0, "min_overlap"), (1.0, None)):
        (one,) = run(track, PLANE.roi(x_m=shift - 200.0, radius_m=200.0), clip=True)
        assert one.overlap == pytest.approx(0.9 + shift / 100.0, abs=1e-7)
        assert one.rule == rule or shift == 0.0
    t, x = np.arange(0.0, 101.0), np.arange(0.0, 101.0)
    whole = PLANE.track(t, np.column_stack([x, np.zeros(101)]))
    (one,) = run(whole, PLANE.roi(x_m=-374.0, radius_m=464.0), clip=True)
    assert (one.overlap, one.rule) == (0.9, "min_overlap")


def test_thresholds_are_options_and_the_first_that_fails_is_named() -> None:
    track = straight(PLANE, 10.0, 30.0)
    (one,) = run(track, PLANE.roi(radius_m=10.0))
    assert one.rule == "min_duration"
    assert run(track, PLANE.roi(radius_m=10.0), min_duration_s=1.0, min_path_m=25.0)[0].rule == "min_path"
    assert run(track, PLANE.roi(radius_m=10.0), min_duration_s=1.0, min_path_m=15.0)[0].accepted


# --- joining and splitting ----------------------------------------------------------------------------------------


def weave(away_s: float, legs: int = 2, speed: float = 10.0) -> Track:
    """Along the circle's edge (a plane's half, for these lengths): 20 s inside, away for a while, 20 s inside."""
    t, x, y, now = [], [], [], 0.0
    for leg in range(legs):
        for step in np.arange(0.0, 20.0, 0.1):
            t.append(now + step)
            y.append(-5.0)
        now += 20.0
        if leg < legs - 1:
            for step in np.arange(0.0, away_s - 1e-9, 0.1):
                t.append(now + step)
                y.append(5.0)
            now += away_s
    x = speed * np.array(t)
    return PLANE.track(np.array(t), np.column_stack([x, np.array(y)]))


EDGE = PLANE.roi(x_m=200.0, y_m=-20_000.0, radius_m=20_000.0)


def test_visits_three_seconds_apart_join_and_more_do_not() -> None:
    # Each crossing lies within a step of 0.1 s; the circle sags by 1 m here.
    for away_s, count in ((2.7, 1), (2.9, 1), (3.2, 2), (3.4, 2)):
        found = run(weave(away_s), EDGE)
        assert len(found) == count, away_s
        assert found[0].visits == 3 - count
        assert not any(one.split for one in found)


def test_join_gap_at_the_nanosecond() -> None:
    for extra_ns, count in ((0, 1), (1, 2)):
        # Crossings fall on fixes: at the circle at 20 s, away, and back at the circle exactly 3 s (and 1 ns) later.
        t_ns = np.concatenate(
            [np.arange(21) * 10**9, [21 * 10**9, 22 * 10**9], 23 * 10**9 + extra_ns + np.arange(21) * 10**9]
        )
        x = np.concatenate([np.arange(21) * 10.0, [203.0, 203.0], 200.0 - np.arange(21) * 10.0])
        track = Track(timestamp_ns=t_ns, x_m=x, y_m=np.zeros(len(x)))
        found = run(track, PLANE.roi(radius_m=200.0))
        assert [one.visits for one in found] == [3 - count] * count


def test_a_bridge_that_costs_the_ninety_percent_is_split() -> None:
    # 40 m inside, 30 m away in 2 s, 40 m inside: joined 73 %; apart each part is whole.
    t = np.arange(0.0, 22.01, 0.1)
    x = np.interp(t, [0, 10, 11, 12, 22], [160.0, 200.0, 215.0, 200.0, 160.0])
    track = PLANE.track(t, np.column_stack([x, np.zeros(len(t))]))
    found = run(track, PLANE.roi(radius_m=200.0), min_duration_s=9.9)
    assert [(one.split, one.visits, one.accepted) for one in found] == [(True, 1, True)] * 2
    assert [one.path_m for one in found] == pytest.approx([40.0, 40.0], abs=1e-3)
    (joined,) = run(track, PLANE.roi(radius_m=200.0), min_overlap=0.7)
    assert (joined.visits, joined.split, joined.accepted) == (2, False, True)
    assert joined.overlap == pytest.approx(80.0 / 110.0, abs=1e-4)
    assert joined.inside_path_m == pytest.approx(80.0, abs=1e-2)


def test_it_is_split_at_the_longest_excursion_alone() -> None:
    # Two excursions: 1 m and 30 m. The first is bridged still, the second is not.
    t = np.arange(0.0, 35.01, 0.1)
    x = np.interp(t, [0, 10, 10.5, 11, 21, 22, 23, 33, 35], [160, 200, 200.5, 200, 200 - 1e-3, 215, 200, 160, 150])
    x[(t > 11.05) & (t < 20.95)] -= 20.0 * np.sin((t[(t > 11.05) & (t < 20.95)] - 11.0) / 10.0 * math.pi)
    track = PLANE.track(t, np.column_stack([x, np.zeros(len(t))]))
    found = run(track, PLANE.roi(radius_m=200.0))
    assert [(one.visits, one.split, one.accepted) for one in found] == [(2, True, True), (1, True, True)]


def test_thousands_of_excursions_do_not_exhaust_the_stack() -> None:
    # Parked on the edge with a receiver that flips between two places.
    t = np.arange(6000.0)
    track = PLANE.track(t, np.column_stack([np.where(t % 2 == 0, 199.9, 200.1), np.zeros(len(t))]))
    found = run(track, PLANE.roi(radius_m=200.0))
    assert len(found) == 3000
    assert not any(one.accepted for one in found)


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


# --- sets of ROIs -------------------------------------------------------------------------------------------------


def test_no_roi_and_rois_of_other_frames() -> None:
    track = straight(PLANE, 10.0, 400.0)
    assert run(track, []) == []
    cleaned, _ = clean(track, CleaningOptions())
    other = Trigger([CITY.roi(), Place(frame="elsewhere").roi()], TriggerOptions(), CleaningOptions())
    assert other.passes(cleaned, frame="yard") == []


def test_one_pose_within_and_without() -> None:
    track = PLANE.track(np.zeros(1), np.zeros((1, 2)))
    (one,) = run(track, PLANE.roi())
    assert (one.duration_s, one.path_m, one.overlap, one.poses, one.rule) == (0.0, 0.0, 1.0, 1, "min_duration")
    assert (one.heading_in_deg, one.heading_out_deg) == (None, None)
    assert run(track, PLANE.roi(x_m=201.0)) == []
    assert run(track, PLANE.roi(), clip=True)[0].rule == "min_duration"


def test_rois_of_all_sizes_together_are_each_found_alone() -> None:
    rng = np.random.default_rng(8)
    driver = Driver(rng)
    for _ in range(30):
        driver.drive(60)
    t, xy = driver.arrays()
    for place in (CITY, ARCTIC, ANTIMERIDIAN, PLANE):
        rois = [
            place.roi(*rng.normal(xy[rng.integers(len(xy))], 100.0), radius_m=radius, scene_id=f"roi_{number:02d}")
            for number, radius in enumerate([1.0, 5.0, 50.0, 200.0, 200.0, 1000.0, 20_000.0] * 3)
        ]
        track = place.track(t, xy)
        together = run(track, rois)
        assert together
        assert together == [one for roi in rois for one in run(track, roi)]


def test_rois_at_one_place_are_all_found() -> None:
    rois = [CITY.roi(radius_m=200.0, scene_id=f"roi_{number}") for number in range(50)]
    found = run(straight(CITY, 10.0, 400.0), rois)
    assert [one.scene_id for one in found] == [roi.scene_id for roi in rois]
    assert len({(one.entry_ns, one.exit_ns) for one in found}) == 1


# --- one drive, many ways -----------------------------------------------------------------------------------------


def city_drives(count: int) -> list[Track]:
    drives = []
    for seed in range(count):
        driver = Driver(np.random.default_rng(seed))
        for name in ("drive", "stand", "drive", "outliers", "drive", "gap", "drive", "duplicate", "shuttle", "drive"):
            Driver.moves()[name](driver, 40)
        drives.append(CITY.track(*driver.arrays()))
    return drives


def test_threads_and_order_change_nothing() -> None:
    rois = [CITY.roi(200.0 * i, 150.0 * j, 120.0, f"roi_{i}_{j}") for i in range(-3, 4) for j in range(-3, 4)]
    tracks = [clean(track, CleaningOptions())[0] for track in city_drives(24)]
    trigger = Trigger(rois, TriggerOptions(), CleaningOptions())
    one_by_one = [trigger.passes(track) for track in tracks]
    assert sum(map(len, one_by_one)) > 100
    for workers, chunk in ((2, 1), (8, 5)):
        with ThreadPoolExecutor(workers) as pool:
            chunks = [tracks[start : start + chunk] for start in range(0, len(tracks), chunk)]
            at_once = [one for part in pool.map(lambda part: [trigger.passes(x) for x in part], chunks) for one in part]
        assert at_once == one_by_one
    assert [trigger.passes(track) for track in reversed(tracks)] == one_by_one[::-1]
    again = Trigger(rois[::-1], TriggerOptions(), CleaningOptions())
    assert [sorted(again.passes(track), key=lambda one: (one.scene_id, one.entry_ns)) for track in tracks] == [
        sorted(passes, key=lambda one: (one.scene_id, one.entry_ns)) for passes in one_by_one
    ]


def test_a_shifted_clock_shifts_the_passes() -> None:
    rois = [CITY.roi(radius_m=150.0)]
    for track in city_drives(6):
        shift = 86_400 * 10**9
        moved = Track(track.timestamp_ns + shift, track.longitude_deg, track.latitude_deg)
        for one, other in zip(run(track, rois), run(moved, rois), strict=True):
            assert (other.entry_ns - one.entry_ns, other.exit_ns - one.exit_ns) == (shift, shift)
            assert (other.path_m, other.rule, other.closest_m) == (one.path_m, one.rule, one.closest_m)


# --- real drives --------------------------------------------------------------------------------------------------


def boreas_track(folder: Path) -> Track:
    table = np.loadtxt(folder / "camera_poses.csv", delimiter=",", skiprows=1, usecols=(1, 2))
    stamps = np.loadtxt(folder / "camera_poses.csv", delimiter=",", skiprows=1, usecols=0, dtype=np.int64)
    lon, lat = utm_to_geodetic(table[:, 0], table[:, 1], 17, True)
    return Track(timestamp_ns=stamps * 1000, longitude_deg=lon, latitude_deg=lat)


def test_both_boreas_loops_pass_the_same_places(real_data: Path) -> None:
    first, second = (boreas_track(folder) for folder in sorted((real_data / "boreas").glob("boreas-*")))
    assert first.longitude_deg is not None
    assert first.latitude_deg is not None
    places = [len(first) // 5, len(first) // 2, 4 * len(first) // 5]
    rois = [
        Roi(scene_id=f"road_{row}", longitude_deg=first.longitude_deg[row], latitude_deg=first.latitude_deg[row])
        for row in places
    ]
    for track in (first, second):
        _, report = clean(track, CleaningOptions())
        assert (report.invalid, report.outliers, report.restarts) == (0, 0, 0)
        found = run(track, rois)
        assert {one.scene_id for one in found if one.accepted} == {roi.scene_id for roi in rois}
        middle = [one for one in found if one.scene_id == rois[1].scene_id]
        for one, ref in zip(middle, reference.passes(track, rois[1:2]), strict=True):
            assert (one.rule, one.visits) == (ref.rule, ref.visits)
            assert one.path_m == pytest.approx(ref.path_m, abs=1e-3)
            assert abs(one.entry_ns - ref.entry_ns) < 1_000_000
            assert abs(one.exit_ns - ref.exit_ns) < 1_000_000


def test_rsk_drives_pass_the_middle_of_their_route(real_data: Path) -> None:
    passed = 0
    for path in sorted((real_data / "rsk_twizy_t3").glob("*.csv")):
        track = rsk_track(path)
        roi = Roi(scene_id="route", longitude_deg=-6.8, latitude_deg=33.98, radius_m=200.0)
        kept, _ = clean(track, CleaningOptions())
        rows = kept.kept()
        middle = rows[len(rows) // 2]
        roi = Roi(scene_id="route", longitude_deg=kept.first[middle], latitude_deg=kept.second[middle], radius_m=200.0)
        assert not any(one.accepted for one in run(track, roi))
        found = run(track, roi, max_gap_s=30.0)
        expected = reference.passes(track, [roi], TriggerOptions(max_gap_s=30.0))
        assert [(one.rule, one.visits) for one in found] == [(one.rule, one.visits) for one in expected]
        passed += any(one.accepted for one in found)
    assert passed >= 8
