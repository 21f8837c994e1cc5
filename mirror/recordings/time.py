"""Time bases of recordings, and their exact conversion to Unix nanoseconds.

Unix time is UTC without leap seconds, as POSIX defines it. GPS time counts every second since 1980-01-06 and is ahead
of UTC by the leap seconds since then: 18 s since 2017. Integers are never converted to floating point: a float64 of
seconds since 1970 resolves only 240 ns.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import AnyArray, Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.schema.casting import EXACT_FLOAT64

SECOND_NS: Final = 1_000_000_000
WEEK_S: Final = 604_800
GPS_EPOCH_NS: Final = 315_964_800 * SECOND_NS

# First days (UTC) with one more leap second between GPS time and UTC: IERS Bulletin C.
_LEAP_DAYS: Final = (
    "1981-07-01",
    "1982-07-01",
    "1983-07-01",
    "1985-07-01",
    "1988-01-01",
    "1990-01-01",
    "1991-01-01",
    "1992-07-01",
    "1993-07-01",
    "1994-07-01",
    "1996-01-01",
    "1997-07-01",
    "1999-01-01",
    "2006-01-01",
    "2009-01-01",
    "2012-07-01",
    "2015-07-01",
    "2017-01-01",
)
_LEAP_UNIX_NS: Final = np.array(_LEAP_DAYS, dtype="datetime64[ns]").astype(np.int64)
_LEAP_GPS_NS: Final = _LEAP_UNIX_NS - GPS_EPOCH_NS + np.arange(1, len(_LEAP_DAYS) + 1) * SECOND_NS


@dataclass(frozen=True)
class TimeBase:
    """The epoch and unit in which a source counts time.

    Attributes:
        words: a description for people.
        unit_ns: length of the unit.
        gps: True: time counts from the GPS epoch, every second included; False: from 1970 in UTC.
        has_date: False: it counts from an arbitrary start, which is taken as 1970.
    """

    words: str
    unit_ns: int
    gps: bool
    has_date: bool = True


_UNITS: Final = {"ns": ("nanoseconds", 1), "us": ("microseconds", 1_000), "ms": ("milliseconds", 1_000_000)}
_EVERY_UNIT: Final = {**_UNITS, "s": ("seconds", SECOND_NS)}
TIME_BASES: Final = {
    f"{clock.lower()}_{unit}": TimeBase(f"{clock} {words}", length, clock == "GPS")
    for clock in ("Unix", "GPS")
    for unit, (words, length) in _EVERY_UNIT.items()
} | {
    f"clock_{unit}": TimeBase(f"{words} of a clock without a date", length, gps=False, has_date=False)
    for unit, (words, length) in _EVERY_UNIT.items()
}


def unix_from_gps_ns(gps_ns: Int64) -> Int64:
    """Convert nanoseconds since the GPS epoch to Unix nanoseconds.

    Unix time has no value for an instant within an inserted leap second: it gets the Unix time of the second before.

    Args:
        gps_ns: (N,) since 1980-01-06T00:00:00 UTC, every second counted.
    """
    leaps = np.searchsorted(_LEAP_GPS_NS - SECOND_NS, gps_ns, side="right")
    return gps_ns + (GPS_EPOCH_NS - leaps * SECOND_NS)


def order_leap_seconds(unix_ns: Int64, in_leap_second: Bool) -> Int64:
    """Give instants within an inserted leap second stamps in order, between the seconds before and after.

    Unix time has one second for two: the leap second and the second before it share it, at half the rate, so that no
    two stamps coincide and their order stays. A stamp is then at most half a second early. Recordings without an
    instant in the leap second keep their stamps.

    Args:
        unix_ns: (N,) Unix time; instants in a leap second have that of the second before.
        in_leap_second: (N,) True for those.
    """
    if not in_leap_second.any():
        return unix_ns
    second = unix_ns // SECOND_NS
    shared = np.isin(second, second[in_leap_second])
    halved = second * SECOND_NS + (unix_ns - second * SECOND_NS + np.where(in_leap_second, SECOND_NS, 0)) // 2
    return np.where(shared, halved, unix_ns)


def ends_in_leap_second(unix_ns: Int64) -> Bool:
    """Mark the seconds (N,) of Unix time after which UTC had a leap second."""
    return np.isin((unix_ns // SECOND_NS + 1) * SECOND_NS, _LEAP_UNIX_NS)


def unix_from_gps_week(week: AnyArray, time_of_week_s: Float64) -> Int64:
    """Convert GPS weeks (not rolled over) and seconds of the week to Unix nanoseconds, exact to the nanosecond.

    Args:
        week: (N,) whole weeks since 1980-01-06.
        time_of_week_s: (N,); as float64 it resolves 0.06 ns.
    """
    return unix_from_gps_ns(np.asarray(week, np.int64) * (WEEK_S * SECOND_NS) + ns_from_seconds(time_of_week_s))


def ns_from_seconds(seconds: Float64) -> Int64:
    """Round seconds to nanoseconds; whole part and fraction are converted apart, so that no digits are lost."""
    whole = np.floor(seconds)
    return whole.astype(np.int64) * SECOND_NS + np.rint((seconds - whole) * SECOND_NS).astype(np.int64)


class StampError(ValueError):
    """Values that are not stamps of their time base.

    Args:
        bad: (N,) True where a value has this problem; other values may have other problems.
        problem: what is wrong with the first bad value.
    """

    def __init__(self, bad: Bool, problem: str) -> None:
        self.bad = bad
        self.row = int(np.argmax(bad))
        self.problem = problem
        super().__init__(problem)


def to_unix_ns(values: pa.ChunkedArray, base: str) -> Int64:
    """Convert a column of numbers to Unix nanoseconds.

    Args:
        values: (N,) integers, text of decimal numbers (exact to the nanosecond), floats up to 2^53, beyond which whole
            numbers are rounded, or Arrow timestamps of any unit (without a zone: UTC).
        base: a key of `TIME_BASES`.

    Returns:
        (N,) Unix time, UTC.

    Raises:
        StampError: a value is missing, not a number, has lost digits, or is too large for its unit; its row is named.
        RecordingError: the time base is unknown.
    """
    if base not in TIME_BASES:
        raise RecordingError(f"unknown time base {base!r}", expected=f"one of {', '.join(TIME_BASES)}")
    kind = TIME_BASES[base]
    _raise_for(np.asarray(pc.is_null(values, nan_is_null=True)), "missing")
    if pa.types.is_timestamp(values.type):
        if kind.gps:
            raise StampError(np.ones(len(values), np.bool_), f"dates ({values.type}) are no {kind.words}: use unix_ns")
        return _from_timestamps(values)
    if pa.types.is_integer(values.type):
        counted = _from_integers(values, kind)
    elif pa.types.is_floating(values.type):
        counted = _from_floats(np.asarray(values, np.float64), kind)
    else:
        counted = _from_text(values, kind)
    if not kind.gps:
        return counted
    begun = np.searchsorted(_LEAP_GPS_NS - SECOND_NS, counted, side="right")
    over = np.searchsorted(_LEAP_GPS_NS, counted, side="right")
    return order_leap_seconds(unix_from_gps_ns(counted), begun > over)


def _from_text(values: pa.ChunkedArray, kind: TimeBase) -> Int64:
    text = pc.utf8_trim_whitespace(values.cast(pa.string()))
    good = pc.match_substring_regex(text, r"^[+-]?[0-9]{1,30}(\.[0-9]{0,12})?$")
    _raise_for(~np.asarray(good), "not a number of at most 12 decimals", text)
    if not pc.any(pc.match_substring(text, ".")).as_py() and pc.max(pc.utf8_length(text)).as_py() <= 18:
        return _from_integers(text.cast(pa.int64()), kind)
    unit = pa.scalar(Decimal(kind.unit_ns), pa.decimal256(11, 0))
    nanoseconds = pc.round(pc.multiply(text.cast(pa.decimal256(50, 12)), unit))
    limit = pa.scalar(Decimal(2**63 - 1 - GPS_EPOCH_NS), nanoseconds.type)
    _raise_for(np.asarray(pc.greater(pc.abs(nanoseconds), limit)), f"too large for {kind.words}", text)
    return np.asarray(nanoseconds.cast(pa.int64()))


def _from_integers(values: pa.ChunkedArray, kind: TimeBase) -> Int64:
    integers = np.asarray(values.cast(pa.int64()))
    # The limit leaves room for the GPS epoch, which is added afterwards.
    limit = (2**63 - 1 - GPS_EPOCH_NS) // kind.unit_ns
    _raise_for(np.abs(integers) > limit, f"too large for {kind.words}", values)
    return integers * kind.unit_ns


def _from_timestamps(values: pa.ChunkedArray) -> Int64:
    unit = values.type.unit
    length = SECOND_NS if unit == "s" else _UNITS[unit][1]
    integers = np.asarray(values.cast(pa.int64()))
    _raise_for(np.abs(integers) > (2**63 - 1) // length, "a date beyond the year 2262", values)
    return integers * length


def _from_floats(values: Float64, kind: TimeBase) -> Int64:
    limit = (2**63 - 1 - GPS_EPOCH_NS) // kind.unit_ns
    _raise_for(~(np.abs(values) < limit), f"not finite, or too large for {kind.words}", values)
    lost = "a float64 beyond 2^53, which has lost digits: write whole numbers as integers (int64)"
    _raise_for(np.abs(values) > EXACT_FLOAT64, lost, values)
    whole = np.floor(values)
    return whole.astype(np.int64) * kind.unit_ns + np.rint((values - whole) * kind.unit_ns).astype(np.int64)


def _raise_for(bad: Bool, problem: str, values: pa.ChunkedArray | AnyArray | None = None) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        raise StampError(bad, f"{values[row]} is {problem}" if values is not None else problem)
