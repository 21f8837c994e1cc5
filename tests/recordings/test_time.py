"""Time bases against Python's own exact arithmetic and published offsets."""

from __future__ import annotations

from decimal import Decimal

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.errors import RecordingError
from mirror.recordings.time import (
    TIME_BASES,
    StampError,
    ns_from_seconds,
    to_unix_ns,
    unix_from_gps_ns,
    unix_from_gps_week,
)

SECOND = 1_000_000_000


def unix(day: str) -> int:
    return int(np.datetime64(day, "ns").astype(np.int64))


@pytest.mark.parametrize(
    ("day", "leap_seconds"),
    [
        ("1980-01-06", 0),
        ("1985-01-01", 3),
        ("1999-08-22", 13),
        ("2012-07-01", 16),
        ("2016-12-31", 17),
        ("2018-08-02", 18),
    ],
)
def test_gps_runs_ahead_of_utc_by_the_published_leap_seconds(day: str, leap_seconds: int) -> None:
    gps_ns = unix(day) - unix("1980-01-06") + leap_seconds * SECOND
    assert unix_from_gps_ns(np.array([gps_ns])) == [unix(day)]


def test_a_leap_second_repeats_the_second_before() -> None:
    # 2017-01-01T00:00:00 UTC is second 18 of GPS week 1930; second 17 is 23:59:60.
    stamps = unix_from_gps_week(np.full(4, 1930), np.array([16.0, 17.0, 17.5, 18.0]))
    expected = unix("2017-01-01") + np.array([-1.0, -1.0, -0.5, 0.0]) * SECOND
    assert stamps.tolist() == expected.astype(np.int64).tolist()


@given(st.integers(0, 604_799), st.integers(0, 999_999_999))
def test_seconds_of_the_week_are_exact_to_the_nanosecond(whole: int, fraction: int) -> None:
    seconds = float(Decimal(whole) + Decimal(fraction).scaleb(-9))
    assert abs(int(ns_from_seconds(np.array([seconds]))[0]) - (whole * SECOND + fraction)) == 0


@given(st.integers(-(10**17), 4 * 10**18), st.sampled_from(sorted(TIME_BASES)))
def test_text_and_integers_are_exact_in_every_unit(ns: int, name: str) -> None:
    base = TIME_BASES[name]
    if base.gps and ns < 0:
        return
    text = format(Decimal(ns) / base.unit_ns, "f")
    expected = int(unix_from_gps_ns(np.array([ns]))[0]) if base.gps else ns
    assert to_unix_ns(pa.chunked_array([[text]]), name).tolist() == [expected]
    whole = ns // base.unit_ns
    counted = whole * base.unit_ns
    expected = int(unix_from_gps_ns(np.array([counted]))[0]) if base.gps else counted
    assert to_unix_ns(pa.chunked_array([[whole]]), name).tolist() == [expected]
    assert to_unix_ns(pa.chunked_array([[str(whole)]]), name).tolist() == [expected]


@given(st.floats(0, 4e9))
def test_float_seconds_keep_their_precision(seconds: float) -> None:
    exact = Decimal(seconds) * SECOND
    assert abs(Decimal(int(to_unix_ns(pa.chunked_array([[seconds]]), "unix_s")[0])) - exact) <= 1


@pytest.mark.parametrize(
    ("values", "base", "row"),
    [
        (["1", "x"], "unix_s", 1),
        (["1", None], "unix_s", 1),
        (["1", "2", "9" * 25], "unix_s", 2),
        (["1e9"], "unix_s", 0),
        ([1, 2**62], "unix_us", 1),
        ([1.0, float("nan")], "unix_s", 1),
        ([1.0, float("inf")], "gps_s", 1),
        # 2^63 ns are 9.22e9 s, less the 0.32e9 s of the epoch of GPS.
        ([8.9e9, 9.3e9], "unix_s", 1),
        ([8.9e9, 9.0e9], "gps_s", 1),
    ],
)
def test_invalid_stamp_is_named_by_its_row(values: list[object], base: str, row: int) -> None:
    with pytest.raises(StampError) as caught:
        to_unix_ns(pa.chunked_array([values]), base)
    assert caught.value.row == row


def test_an_unknown_base_is_refused() -> None:
    with pytest.raises(RecordingError, match="unknown time base"):
        to_unix_ns(pa.chunked_array([[1]]), "tai_s")


def test_a_column_may_be_empty() -> None:
    assert len(to_unix_ns(pa.chunked_array([pa.array([], pa.int64())]), "unix_s")) == 0


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
def test_arrow_timestamps_are_read_in_any_unit(unit: str, zone: str | None) -> None:
    """An Arrow timestamp counts from 1970 in UTC, whatever zone it is shown in; without a zone it is taken as UTC."""
    whole = np.array(["2026-03-01T10:00:00", "2026-03-01T10:00:01"], "datetime64[ns]").astype(np.int64)
    column = pa.chunked_array([pa.array(whole, pa.timestamp("ns", zone)).cast(pa.timestamp(unit, zone))])
    for base in ("unix_ns", "unix_us", "unix_s"):
        np.testing.assert_array_equal(to_unix_ns(column, base), whole)
    with pytest.raises(StampError, match="use unix_ns"):
        to_unix_ns(column, "gps_us")


def test_floats_beyond_2_53_have_lost_digits() -> None:
    stamps = np.array([1_772_359_200_123_456_789, 5], np.int64)
    with pytest.raises(StampError, match=r"beyond 2\^53") as caught:
        to_unix_ns(pa.chunked_array([stamps.astype(np.float64)]), "unix_ns")
    assert caught.value.bad.tolist() == [True, False]
    # Microseconds and seconds since 1970 fit.
    for base, length in (("unix_us", 1_000), ("unix_s", 10**9)):
        exact = stamps // 10**9 * 10**9
        np.testing.assert_array_equal(to_unix_ns(pa.chunked_array([exact / length]), base), exact)


def test_poses_in_a_leap_second_keep_stamps_of_their_own_and_their_order() -> None:
    """Ten a second from 23:59:58 to 00:00:01, counted by GPS: none coincide, and only two seconds are moved."""
    gps_us = (1930 * 604_800 + 15) * 1_000_000 + 100_000 * np.arange(40)
    stamps = to_unix_ns(pa.chunked_array([gps_us]), "gps_us")
    midnight = unix("2017-01-01")
    assert (np.diff(stamps) > 0).all()
    assert stamps[:10].tolist() == [midnight - 2 * SECOND + 100_000_000 * number for number in range(10)]
    assert stamps[10:30].tolist() == [midnight - SECOND + 50_000_000 * number for number in range(20)]
    assert stamps[30:].tolist() == [midnight + 100_000_000 * number for number in range(10)]
    # Without an instant in the leap second nothing is moved.
    before = to_unix_ns(pa.chunked_array([gps_us[:20]]), "gps_us")
    assert before[10:].tolist() == [midnight - SECOND + 100_000_000 * number for number in range(10)]
