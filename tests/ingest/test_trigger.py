"""The ROI trigger where the answer is known in closed form: circles, the paper's thresholds, joining, splitting."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, Roi
from tests.ingest import reference
from tests.ingest.drives import ANTIMERIDIAN, FAR_PLANE, PLACES, PLANE, Place
from tests.ingest.passes import run, seconds, straight
from tests.ingest.reference_cleaning import cleaned
from tests.ingest.surfaces import Globe, centre_of

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
        surface, fixes = Globe(), cleaned(track, CleaningOptions())
        centre = centre_of(roi)
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
