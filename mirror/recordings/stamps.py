"""Parses date and time as text: each drive has one format, which its rows or the user decide for all rows at once."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Bool, Int64
from mirror.errors import RecordingError
from mirror.recordings.tabular import RecordingRows
from mirror.recordings.time import SECOND_NS, ends_in_leap_second, order_leap_seconds

FORMATS: Final = ("YYYY-MM-DD", "MM/DD/YYYY", "DD/MM/YYYY")
_STAMP: Final = (
    r"^(?P<a>[0-9]{1,4})[-/.](?P<b>[0-9]{1,2})[-/.](?P<c>[0-9]{1,4})[T ]+"
    r"(?P<hour>[0-9]{1,2}):(?P<minute>[0-9]{2})(?::(?P<second>[0-9]{2})(?:[.,](?P<fraction>[0-9]{1,9}))?)?"
    r" *(?P<zone>Z|UTC|[+-][0-9]{2}(?::?[0-9]{2})?)?$"
)
_PARTS: Final = {"YYYY": "year", "MM": "month", "DD": "day"}
_ORDERS: Final = {"the day first": ("c", "b", "a"), "the month first": ("c", "a", "b")}
_EXPECTED: Final = "a date and time such as 2021-08-05T17:34:46.438+00:00, 08/05/2021 17:34:46 or 05/08/2021 17:34:46"


def parse_stamps(
    rows: RecordingRows, column: str, text: pa.ChunkedArray, *, tz: str | None, date_format: str | None
) -> Int64:
    """Convert dates and times to Unix nanoseconds; ``23:59:60`` exists where UTC had a leap second.

    A stamp with an offset (``Z``, ``+02:00``) states its own zone; a stamp without one is local time in ``tz``. The
    rows that can be read in one order only decide whether ``04/05`` is in April or in May: the more frequent order is
    taken, and rows of the other order are bad. A drive without such rows is refused.

    Args:
        rows: the table, for the messages.
        column: the column's name, for the messages.
        text: (N,) the stamps, ``<date>T<time>`` or ``<date> <time>``.
        tz: IANA name of the zone of stamps without an offset.
        date_format: order and separators of the date, in the letters of `FORMATS`; None: decided by the rows.

    Returns:
        (N,) Unix time, UTC; any value in rows that are marked as bad.

    Raises:
        RecordingError: the zone or the order is not known; or a stamp does not exist or is ambiguous, and the table
            does not mark bad rows. The row is named, with the remedy.
    """
    text = pc.fill_null(text, "")
    remedy = "correct or remove the row"
    if date_format is None:
        remedy += ", or state the format: --option date_format=MM/DD/YYYY"

    def refuse(wrong: Bool, problem: Callable[[str], str]) -> None:
        rows.refuse(
            wrong, column, lambda row: problem(text[row].as_py()), expected=_EXPECTED, remedy=remedy, reason="time"
        )

    matches = pc.extract_regex(pc.utf8_trim_whitespace(text), _STAMP)
    bad = np.asarray(pc.is_null(matches))
    refuse(bad, lambda stamp: f"{stamp!r} is not a date and time")
    if bad.all():
        return np.zeros(len(bad), np.int64)
    parts = {name: pc.fill_null(pc.struct_field(matches, name), "") for name in matches.type.names}
    date = {name: _number(parts[name]) for name in "abc"}
    if date_format:
        order = _parse_order(date_format)
    else:
        order, odd, other = _decide_order(rows, column, text, parts, date, ~bad)
        refuse(odd & ~bad, other)
        bad = bad | odd
    year, month, day = (date[letter] for letter in order)
    hour, minute, second = (_number(parts[name]) for name in ("hour", "minute", "second"))
    # int64 nanoseconds since 1970 reach from 1678 to 2261.
    wrong = ~_is_date(year, month, day) | (year < 1678) | (year > 2261) | (hour > 23) | (minute > 59) | (second > 60)
    refuse(wrong & ~bad, lambda stamp: f"{stamp!r} does not exist")
    bad = bad | wrong
    days = _first_day(year, month).astype(np.int64) + day - 1
    is_leap: Bool = second == 60
    local = ((days * 24 + hour) * 60 + minute) * 60 + np.minimum(second, 59)
    fraction = _number(pc.utf8_rpad(parts["fraction"], 9, "0"))
    local_ns = np.where(bad, 0, local) * SECOND_NS + np.where(bad, 0, fraction)
    utc_ns = _to_utc(rows, column, text, local_ns, parts["zone"], tz, ~bad)
    refuse(is_leap & ~ends_in_leap_second(utc_ns) & ~bad, lambda stamp: f"{stamp!r} does not exist")
    return order_leap_seconds(utc_ns, is_leap & ~bad)


def _first_day(year: Int64, month: Int64) -> npt.NDArray[np.datetime64]:
    months = (np.clip(year, 1, 9999) - 1970) * 12 + np.clip(month, 1, 12) - 1
    return months.astype("datetime64[M]").astype("datetime64[D]")


def _is_date(year: Int64, month: Int64, day: Int64) -> Bool:
    """(N,) True where the calendar has the date."""
    december = month == 12
    following = _first_day(year + december, np.where(december, 1, month + 1))
    length = (following - _first_day(year, month)).astype(np.int64)
    return (year >= 1) & (year <= 9998) & (month >= 1) & (month <= 12) & (day >= 1) & (day <= length)


def _parse_order(date_format: str) -> tuple[str, str, str]:
    names = [_PARTS.get(token, "") for token in re.split(r"[-/.]", date_format)]
    if sorted(names) != ["day", "month", "year"]:
        raise RecordingError(
            f"date_format {date_format!r} is not understood",
            expected=f"YYYY, MM and DD with -, / or . between them, such as {', '.join(FORMATS)}",
        )
    letters = dict(zip(names, "abc"))
    return letters["year"], letters["month"], letters["day"]


def _decide_order(
    rows: RecordingRows,
    column: str,
    text: pa.ChunkedArray,
    parts: dict[str, pa.Array],
    date: dict[str, Int64],
    good: Bool,
) -> tuple[tuple[str, str, str], Bool, Callable[[str], str]]:
    """Decide the order of year, month and day from the ``good`` rows.

    Returns:
        The order, (N,) True where a row has another order, and a function from such a stamp to its problem.
    """

    def no_date(stamp: str) -> str:
        return f"{stamp!r} is not a date in this drive's format"

    year_first = np.asarray(pc.greater_equal(pc.utf8_length(parts["a"]), 3))
    if 2 * np.count_nonzero(year_first & good) > np.count_nonzero(good):
        return ("a", "b", "c"), ~year_first, no_date
    possible = ~year_first & np.asarray(pc.equal(pc.utf8_length(parts["c"]), 4)) & good
    reads = {name: possible & _is_date(*(date[letter] for letter in order)) for name, order in _ORDERS.items()}
    neither = ~(reads["the day first"] | reads["the month first"])
    day_only = reads["the day first"] & ~reads["the month first"]
    month_only = reads["the month first"] & ~reads["the day first"]
    if not (day_only.any() or month_only.any()):
        if neither[good].all():
            return _ORDERS["the day first"], neither, no_date
        row = int(np.argmax(~neither))
        raise rows.error(
            row,
            column,
            f"{text[row].as_py()!r} may be month first or day first, and no row of the drive decides it",
            expected="one format",
            remedy="state the format: --option date_format=MM/DD/YYYY or --option date_format=DD/MM/YYYY",
        )
    day_first = bool(np.count_nonzero(day_only) > np.count_nonzero(month_only))
    words, other_words = ("the day first", "the month first") if day_first else ("the month first", "the day first")
    ours, others = (day_only, month_only) if day_first else (month_only, day_only)
    witness = int(np.argmax(ours))
    file, place = rows.locate(witness)

    def problem(stamp: str) -> str:
        if stamp not in contrary:
            return no_date(stamp)
        return f"{stamp!r} puts {other_words}, {text[witness].as_py()!r} ({file.name}, {place}) {words.split()[1]}"

    contrary = set(pc.unique(pc.filter(text, pa.array(others))).to_pylist())
    return _ORDERS[words], neither | others, problem


def _to_utc(
    rows: RecordingRows, column: str, text: pa.ChunkedArray, local_ns: Int64, zone: pa.Array, tz: str | None, good: Bool
) -> Int64:
    if tz is not None:
        require_zone(tz)
    stated = np.asarray(pc.greater(pc.utf8_length(zone), 0))
    out = local_ns - _offset_ns(zone) if stated.any() else local_ns
    naive = ~stated & good
    if not naive.any():
        return out
    if tz is None:
        row = int(np.argmax(naive))
        raise rows.error(
            row,
            column,
            f"{text[row].as_py()!r} is local time of an unknown zone",
            expected="an offset such as Z or +02:00 in the stamp",
            remedy="give the zone that the clock was set to, e.g. --tz Europe/Berlin, or --tz UTC",
        )
    times = pa.array(local_ns[naive], pa.timestamp("ns"))
    early, late = (
        np.asarray(pc.assume_timezone(times, tz, ambiguous=which, nonexistent=which).cast(pa.int64()))
        for which in ("earliest", "latest")
    )
    double: Bool = np.zeros(len(out), np.bool_)
    double[naive] = early != late
    rows.refuse(
        double,
        column,
        f"a local time that {tz} has twice or not at all, because its clocks were changed",
        expected="stamps that name one instant",
        remedy="give stamps with an offset, or a zone without clock changes if the logger used one: --tz Etc/GMT-1",
        reason="time",
    )
    out[naive] = early
    return out


def has_offset(text: pa.ChunkedArray) -> Bool:
    """Mark the dates and times (N,) that state their own zone."""
    return np.asarray(pc.match_substring_regex(pc.utf8_trim_whitespace(text), r"(Z|UTC|:[0-9]{2}.*[+-][0-9:]+)$"))


def require_zone(tz: str) -> None:
    """Refuse an unknown time zone.

    Raises:
        RecordingError: it is not an IANA name.
    """
    try:
        pc.assume_timezone(pa.array([0], pa.timestamp("ns")), tz)
    except pa.ArrowInvalid as error:
        raise RecordingError(
            f"unknown time zone {tz!r}", place="option tz", expected="an IANA name such as Europe/Berlin or UTC"
        ) from error


def _offset_ns(zone: pa.Array) -> Int64:
    digits = pc.replace_substring_regex(zone, r"[^0-9]", "")
    hours = _number(pc.utf8_slice_codeunits(digits, 0, 2))
    minutes = _number(pc.utf8_slice_codeunits(digits, 2, 4))
    sign = np.where(np.asarray(pc.starts_with(zone, "-")), -1, 1)
    return sign * (hours * 60 + minutes) * 60 * SECOND_NS


def _number(text: pa.Array) -> Int64:
    """Convert digits to int64; an empty text is 0."""
    return np.asarray(pc.if_else(pc.equal(text, ""), "0", text).cast(pa.int64()))
