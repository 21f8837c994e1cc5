"""Cleaning: the status of each fix in cases solved by hand, bad input, and real drives with errors."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import pytest

from mirror.arrays import read_only
from mirror.errors import RecordingError
from mirror.ingest.clean import CleanTrack, clean
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, CleaningReport
from tests.ingest import reference_cleaning
from tests.ingest.drives import ANTIMERIDIAN, CITY, PLANE, T0_NS, Driver
from tests.ingest.rsk import rsk_track

STATUSES = ("kept", "restart", "invalid", "duplicate_time", "repeated", "outlier")
LETTERS = dict(zip(STATUSES, "KRidro"))


def cleaned(t_s: object, x_m: object, y_m: object = None, **options: object) -> tuple[str, CleanTrack, CleaningReport]:
    """Clean a drive given in metres; its fates as a word, a letter a fix."""
    x = np.asarray(x_m, np.float64)
    xy = np.column_stack([x, np.zeros(len(x)) if y_m is None else np.asarray(y_m, np.float64)])
    track, report = clean(PLANE.track(np.asarray(t_s, np.float64), xy), CleaningOptions(**options))
    return "".join(LETTERS[STATUSES[status]] for status in track.status), track, report


def test_a_clean_drive_stays() -> None:
    word, track, report = cleaned(np.arange(10), np.arange(10) * 15.0)
    assert word == "K" * 10
    assert track.order is None
    assert report == CleaningReport(
        poses=10, kept=10, invalid=0, backward_time=0, duplicate_time=0, repeated=0, outliers=0, restarts=0
    )


def test_not_finite_and_absurd_fixes() -> None:
    word, _, report = cleaned(range(6), [0, np.nan, np.inf, -np.inf, 2e9, 5])
    assert word == "KiiiiK"
    assert (report.invalid, report.kept) == (4, 2)
    off_the_globe = Track(
        timestamp_ns=np.arange(4),
        longitude_deg=np.array([8.0, 1555.0, 8.0, 8.0]),
        latitude_deg=np.array([49, 49, 91, np.nan]),
    )
    assert clean(off_the_globe, CleaningOptions())[1].invalid == 3


def test_equal_stamps_keep_the_first_and_a_wild_first_does_not_count() -> None:
    word, _, report = cleaned([0, 1, 1, 1, 2], [0, 10, 11, 500, 20])
    assert (word, report.duplicate_time) == ("KKddK", 2)
    word, _, _ = cleaned([0, 1, 1, 2, 3], [0, 5000, 10, 20, 30])
    assert word == "KoKKK"


def test_backward_time_is_sorted_or_refused() -> None:
    word, track, report = cleaned([0, 1, 3, 2, 4], [0, 10, 30, 20, 40])
    assert (word, report.backward_time) == ("KKKKK", 1)
    assert track.order is not None
    assert track.recorded(track.kept()).tolist() == [0, 1, 3, 2, 4]
    assert track.lon_or_x.tolist() == [0, 10, 20, 30, 40]
    with pytest.raises(RecordingError, match="time runs backward") as error:
        cleaned([0, 1, 3, 2, 4], [0, 10, 30, 20, 40], backward_time="refuse")
    assert error.value.place == "pose 3"
    assert "sort" in str(error.value.remedy)


def test_sorting_takes_sigma_along() -> None:
    track = Track(
        timestamp_ns=np.array([2, 0, 1]) * 10**9,
        x_m=np.array([20.0, 0.0, 10.0]),
        y_m=np.zeros(3),
        sigma_m=np.array([0.3, 0.1, 0.2]),
    )
    sigma = clean(track, CleaningOptions())[0].sigma_m
    assert sigma is not None
    assert sigma.tolist() == [0.1, 0.2, 0.3]


def test_a_frozen_receiver_moved_on_the_straight_line() -> None:
    # The fix changes by 170 m every 13 s, in rows of 1 Hz: 13 m/s, not 170 m in one second.
    t = np.arange(52)
    word, _, report = cleaned(t, (t // 13) * 170.0)
    assert word == "Krrrrrrrrrrrr" * 3 + "K" + "K" * 12
    assert (report.repeated, report.outliers) == (36, 0)


def test_a_standing_vehicle_keeps_its_stand() -> None:
    word, _, _ = cleaned(range(8), [0, 10, 10, 10, 10, 12, 24, 36])
    assert word == "KKKKKKKK"
    # The same with a wild fix between the stand and the step out of it: the stand is no less long.
    word, _, _ = cleaned(range(9), [0, 10, 10, 10, 10, 9000, 12, 24, 36])
    assert word == "KKKKKoKKK"
    # At the end of the recording there is no step out: it stood.
    assert cleaned(range(5), [0, 10, 10, 10, 10])[0] == "KKKKK"


def test_speed_test() -> None:
    # 70 m/s times 1 s plus 5 m of noise is 75 m from the last good fix; twice that after two seconds less the noise.
    assert cleaned([0, 1, 2], [0, 75, 150])[0] == "KKK"
    assert cleaned([0, 1, 2], [0, 75.1, 140])[0] == "KoK"
    assert cleaned([0, 1, 2], [0, 5000, 145])[0] == "KoK"


def test_acceleration_test() -> None:
    # Off the line between its neighbours by at most 12 / 2 * 1 * 1 + 5 = 11 m.
    assert cleaned(range(5), [0, 10, 20, 30, 40], [0, 0, 10.9, 0, 0])[0] == "KKKKK"
    assert cleaned(range(5), [0, 10, 20, 30, 40], [0, 0, 11.1, 0, 0])[0] == "KKoKK"


def test_hard_braking_is_no_outlier() -> None:
    t = np.arange(0, 6, 0.1)
    speed = np.maximum(30.0 - 9.0 * np.maximum(t - 1.0, 0.0), 0.0)
    word, _, _ = cleaned(t, np.concatenate([[0.0], np.cumsum(speed[:-1] * 0.1)]))
    assert "o" not in word


def test_a_new_track_is_taken_up_after_three_that_agree() -> None:
    there = [5000 + 10.0 * i for i in range(5)]
    word, _, report = cleaned(range(10), [0, 10, 20, 30, 40, *there])
    assert (word, report.restarts) == ("KKKKKRKKKK", 1)
    # Two that agree are outliers; so are three that disagree.
    assert cleaned(range(8), [0, 10, 20, 5000, 5010, 50, 60, 70])[0] == "KKKooKKK"
    assert cleaned(range(8), [0, 10, 20, 5000, -9000, 70000, 60, 70])[0] == "KKKoooKK"
    # A fix at the good place between them ends the row: the good track is alive.
    assert cleaned(range(7), [0, 10, 5000, 10, 5010, 10, 5020])[0] == "KKoKoKo"


def test_a_wrong_first_fix_is_dropped() -> None:
    word, track, report = cleaned(range(6), [90000, 0, 10, 20, 30, 40])
    assert word == "oRKKKK"
    assert (report.kept, report.outliers, report.restarts) == (5, 1, 1)
    assert track.kept().tolist() == [1, 2, 3, 4, 5]


def test_the_antimeridian_is_no_leap() -> None:
    t = np.arange(30.0)
    xy = np.column_stack([(t - 15.0) * 10.0, np.zeros(30)])
    track, report = clean(ANTIMERIDIAN.track(t, xy), CleaningOptions())
    assert report.kept == 30
    assert (track.lon_or_x.min(), track.lon_or_x.max()) < (-179.9, 180.0)


@pytest.mark.parametrize(
    ("stamps", "first"),
    [([], []), ([0], [np.nan]), ([0, 1, 2], [np.nan, np.inf, 4e9])],
    ids=["empty", "one NaN", "none usable"],
)
def test_nothing_usable_is_an_error_that_says_so(stamps: list[int], first: list[float]) -> None:
    track = Track(
        timestamp_ns=np.array(stamps, np.int64), x_m=np.array(first), y_m=np.zeros(len(first)), file=Path("poses.csv")
    )
    with pytest.raises(RecordingError, match=r"no pose at all|poses is usable") as error:
        clean(track, CleaningOptions())
    assert error.value.file == "poses.csv"


def test_a_track_without_positions_or_of_unequal_columns_is_an_error() -> None:
    with pytest.raises(RecordingError, match="neither"):
        clean(Track(timestamp_ns=np.arange(3)), CleaningOptions())
    with pytest.raises(RecordingError, match=r"y_m .*\(2,\)"):
        Track(timestamp_ns=np.arange(3), x_m=np.zeros(3), y_m=np.zeros(2))


def test_one_pose_and_all_at_one_place() -> None:
    assert cleaned([0], [7.0])[0] == "K"
    assert cleaned(range(5), [7.0] * 5)[0] == "KKKKK"
    assert cleaned([0] * 5, [7.0, 8.0, 9.0, 10.0, 11.0])[0] == "Kdddd"


def test_input_is_not_written_to() -> None:
    stamps, x, y = np.array([2, 1, 0]) * 10**9, np.array([0.0, 1.0, np.nan]), np.zeros(3)
    before = stamps.copy(), x.copy()
    for array in (stamps, x, y):
        array.flags.writeable = False
    clean(Track(timestamp_ns=stamps, x_m=x, y_m=y), CleaningOptions())
    np.testing.assert_array_equal(stamps, before[0])
    np.testing.assert_array_equal(x, before[1])


def test_arrays_that_cannot_be_written_to_need_no_other_kernels() -> None:
    stamps, x = np.arange(20) * 10**8, np.arange(20.0)
    tracks = [Track(timestamp_ns=stamps, x_m=x, y_m=np.zeros(20))]
    tracks.append(Track(timestamp_ns=read_only(stamps), x_m=read_only(x), y_m=read_only(np.zeros(20))))
    first, second = (clean(track, CleaningOptions())[0].fixes() for track in tracks)
    assert numba.typeof(first) == numba.typeof(second)


def test_strided_and_narrow_columns_are_read_alike() -> None:
    table = np.zeros((20, 3))
    table[:, 0], table[:, 1] = np.arange(20), np.arange(20) * 12
    expected = cleaned(table[:, 0], table[:, 1])[1]
    strided = Track(timestamp_ns=expected.timestamp_ns, x_m=table[:, 1], y_m=table[:, 2])
    narrow = Track(
        timestamp_ns=expected.timestamp_ns,
        x_m=table[:, 1].astype(np.int32),  # type: ignore[arg-type]
        y_m=table[:, 2].astype(np.float32),  # type: ignore[arg-type]
    )
    for track in (strided, narrow):
        np.testing.assert_array_equal(clean(track, CleaningOptions())[0].status, expected.status)


def test_a_shift_in_time_or_place_changes_nothing() -> None:
    driver = Driver(np.random.default_rng(5))
    for name in ("drive", "outliers", "drive", "repeat", "drive", "jump", "drive", "stand"):
        Driver.moves()[name](driver, 25)
    t, xy = driver.arrays()
    near = clean(PLANE.track(t, xy), CleaningOptions())[0]
    far = Track(timestamp_ns=near.timestamp_ns - T0_NS, x_m=xy[:, 0] + 2.0**20, y_m=xy[:, 1] - 2.0**20)
    np.testing.assert_array_equal(clean(far, CleaningOptions())[0].status, near.status)


def test_several_threads_at_once() -> None:
    driver = Driver(np.random.default_rng(11))
    for _ in range(4):
        for name in ("drive", "outliers", "gap", "repeat", "nothing"):
            Driver.moves()[name](driver, 30)
    t, xy = driver.arrays()
    track = CITY.track(t, xy)
    alone = clean(track, CleaningOptions())[0].status
    with ThreadPoolExecutor(8) as pool:
        for one, _ in pool.map(lambda _: clean(track, CleaningOptions()), range(32)):
            np.testing.assert_array_equal(one.status, alone)


def test_the_dirty_drives_of_rsk(real_data: Path) -> None:
    total: Counter[str] = Counter()
    for path in sorted((real_data / "rsk_twizy_t3").glob("*.csv")):
        track = rsk_track(path)
        kept, report = clean(track, CleaningOptions())
        total.update(report.model_dump(exclude={"bad_rows"}))
        assert track.longitude_deg is not None
        # The wild fix at longitude 1555 stands in three rows of one drive.
        assert report.invalid == np.count_nonzero(np.abs(track.longitude_deg) > 180.0)
        assert report.kept + report.invalid + report.duplicate_time + report.repeated + report.outliers == report.poses
        assert np.all(np.abs(kept.lon_or_x[kept.kept()]) <= 180.0)
        expected, _ = reference_cleaning.statuses(track, CleaningOptions())
        assert [STATUSES[status] for status in kept.status] == expected
    assert (total["poses"], total["kept"], total["repeated"]) == (12_589, 1_459, 11_127)
    assert (total["invalid"], total["outliers"], total["restarts"]) == (3, 0, 0)
