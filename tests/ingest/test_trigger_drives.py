"""The ROI trigger on sets of ROIs, in any order and from many threads, and on real drives."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from mirror.geometry.geodesy import utm_to_geodetic
from mirror.ingest.clean import clean
from mirror.ingest.trigger import RoiTrigger
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions
from tests.ingest import reference
from tests.ingest.drives import ANTIMERIDIAN, ARCTIC, CITY, PLANE, Driver, Place
from tests.ingest.passes import run, straight
from tests.ingest.rsk import rsk_track

# --- sets of ROIs -------------------------------------------------------------------------------------------------


def test_no_roi_and_rois_of_other_frames() -> None:
    track = straight(PLANE, 10.0, 400.0)
    assert run(track, []) == []
    cleaned, _ = clean(track, CleaningOptions())
    other = RoiTrigger([CITY.roi(), Place(frame="elsewhere").roi()], TriggerOptions(), CleaningOptions())
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
    trigger = RoiTrigger(rois, TriggerOptions(), CleaningOptions())
    one_by_one = [trigger.passes(track) for track in tracks]
    assert sum(map(len, one_by_one)) > 100
    for workers, chunk in ((2, 1), (8, 5)):
        with ThreadPoolExecutor(workers) as pool:
            chunks = [tracks[start : start + chunk] for start in range(0, len(tracks), chunk)]
            at_once = [one for part in pool.map(lambda part: [trigger.passes(x) for x in part], chunks) for one in part]
        assert at_once == one_by_one
    assert [trigger.passes(track) for track in reversed(tracks)] == one_by_one[::-1]
    again = RoiTrigger(rois[::-1], TriggerOptions(), CleaningOptions())
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
        roi = Roi(
            scene_id="route", longitude_deg=kept.lon_or_x[middle], latitude_deg=kept.lat_or_y[middle], radius_m=200.0
        )
        assert not any(one.accepted for one in run(track, roi))
        found = run(track, roi, max_gap_s=30.0)
        expected = reference.passes(track, [roi], TriggerOptions(max_gap_s=30.0))
        assert [(one.rule, one.visits) for one in found] == [(one.rule, one.visits) for one in expected]
        passed += any(one.accepted for one in found)
    assert passed >= 8
