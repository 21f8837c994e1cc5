"""Date and time as text: one format a drive, decided by its own rows or by the user, never guessed row by row."""

from __future__ import annotations

import re
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Bool, Int64
from mirror.errors import RecordingError
from mirror.recordings.tabular import Rows
from mirror.recordings.time import SECOND_NS

FORMATS: Final = ("YYYY-MM-DD", "MM/DD/YYYY", "DD/MM/YYYY")
_STAMP: Final = (
    r"^(?P<a>[0-9]{1,4})[-/.](?P<b>[0-9]{1,2})[-/.](?P<c>[0-9]{1,4})[T ]+"
    r"(?P<hour>[0-9]{1,2}):(?P<minute>[0-9]{2})(?::(?P<second>[0-9]{2})(?:[.,](?P<fraction>[0-9]{1,9}))?)?"
    r" *(?P<zone>Z|UTC|[+-][0-9]{2}(?::?[0-9]{2})?)?$"
)
_PARTS: Final = {"YYYY": "year", "MM": "month", "DD": "day"}
_EXPECTED: Final = "a date and time such as 2021-08-05T17:34:46.438+00:00, 08/05/2021 17:34:46 or 05/08/2021 17:34:46"


def parse_stamps(rows: Rows, column: str, text: pa.ChunkedArray, *, tz: str | None, date_format: str | None) -> Int64:
    """Unix nanoseconds of dates and times.

    A stamp with an offset (``Z``, ``+02:00``) says its own zone; one without is local time in ``tz``. Whether ``04/05``
    is in April or in May is decided by a row that can be read only one way; a drive with no such row is refused.

    Args:
        rows: the table, for the messages.
        column: the column's name, for the messages.
        text: (N,) the stamps, ``<date>T<time>`` or ``<date> <time>``.
        tz: IANA name of the zone of stamps without an offset.
        date_format: order and separators of the date, in the letters of `FORMATS`; None: decided by the rows.

    Returns:
        (N,) Unix time, UTC.

    Raises:
        RecordingError: a stamp does not exist or is ambiguous; the row is named, with the remedy.
    """
    found = pc.extract_regex(pc.utf8_trim_whitespace(text), _STAMP)
    wrong = np.asarray(pc.is_null(found))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise _wrong(rows, row, column, f"{text[row].as_py()!r} is no date and time")
    found = found.combine_chunks() if isinstance(found, pa.ChunkedArray) else found
    parts = {field.name: found.field(index) for index, field in enumerate(found.type)}
    date = {name: _number(parts[name]) for name in "abc"}
    order = _order_given(date_format) if date_format else _order(rows, column, text, parts, date)
    year, month, day = (date[letter] for letter in order)
    hour, minute, second = (_number(parts[name]) for name in ("hour", "minute", "second"))
    months = (np.clip(year, 1, 9999) - 1970) * 12 + np.clip(month, 1, 12) - 1
    first = months.astype("datetime64[M]").astype("datetime64[D]")
    length = ((months + 1).astype("datetime64[M]").astype("datetime64[D]") - first).astype(np.int64)
    # Years that nanoseconds since 1970 can count.
    bad = (year < 1678) | (year > 2261) | (month < 1) | (month > 12) | (day < 1) | (day > length)
    bad |= (hour > 23) | (minute > 59) | (second > 59)
    if bad.any():
        row = int(np.argmax(bad))
        raise _wrong(rows, row, column, f"{text[row].as_py()!r} does not exist")
    days = first.astype(np.int64) + day - 1
    local = ((days * 24 + hour) * 60 + minute) * 60 + second
    fraction = _number(pc.utf8_rpad(parts["fraction"], 9, "0"))
    return _to_utc(rows, column, text, local * SECOND_NS + fraction, parts["zone"], tz)


def _order_given(date_format: str) -> tuple[str, str, str]:
    names = [_PARTS.get(token, "") for token in re.split(r"[-/.]", date_format)]
    if sorted(names) != ["day", "month", "year"]:
        raise RecordingError(
            f"date_format {date_format!r} is not understood",
            expected=f"YYYY, MM and DD with -, / or . between them, such as {', '.join(FORMATS)}",
        )
    letters = dict(zip(names, "abc"))
    return letters["year"], letters["month"], letters["day"]


def _order(
    rows: Rows, column: str, text: pa.ChunkedArray, parts: dict[str, pa.Array], date: dict[str, Int64]
) -> tuple[str, str, str]:
    year_first = np.asarray(pc.greater_equal(pc.utf8_length(parts["a"]), 3))
    if year_first.all():
        return "a", "b", "c"
    impossible = year_first | ((date["a"] > 12) & (date["b"] > 12)) | (np.maximum(date["a"], date["b"]) > 31)
    impossible |= np.asarray(pc.not_equal(pc.utf8_length(parts["c"]), 4))
    if impossible.any():
        row = int(np.argmax(impossible))
        raise _wrong(rows, row, column, f"{text[row].as_py()!r} is no date of this drive's format")
    day_first, month_first = date["a"] > 12, date["b"] > 12
    if day_first.any() and month_first.any():
        row, other = int(np.argmax(day_first)), int(np.argmax(month_first))
        file, place = rows.locate(other)
        raise _wrong(
            rows,
            row,
            column,
            f"{text[row].as_py()!r} puts the day first, {text[other].as_py()!r} ({file.name}, {place}) the month",
        )
    if not (day_first.any() or month_first.any()):
        raise rows.error(
            0,
            column,
            f"{text[0].as_py()!r} may be month first or day first, and no row of the drive decides it",
            expected="one format",
            remedy="say which: --option date_format=MM/DD/YYYY or --option date_format=DD/MM/YYYY",
        )
    return ("c", "b", "a") if day_first.any() else ("c", "a", "b")


def _to_utc(rows: Rows, column: str, text: pa.ChunkedArray, local_ns: Int64, zone: pa.Array, tz: str | None) -> Int64:
    if tz is not None:
        require_zone(tz)
    stated = np.asarray(pc.greater(pc.utf8_length(zone), 0))
    out = local_ns - _offset_ns(zone) if stated.any() else local_ns
    naive = ~stated
    if not naive.any():
        return out
    if tz is None:
        row = int(np.argmax(naive))
        raise rows.error(
            row,
            column,
            f"{text[row].as_py()!r} is local time of an unknown zone",
            expected="an offset such as Z or +02:00 in the stamp",
            remedy="give the zone the clock was set to, e.g. --tz Europe/Berlin, or --tz UTC",
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
        f"a local time that {tz} has twice or not at all: its clocks were changed then",
        expected="stamps that name one instant",
        remedy="give stamps with an offset, or the zone the logger kept all the time, e.g. --tz Etc/GMT-1",
    )
    out[naive] = early
    return out


def has_offset(text: pa.ChunkedArray) -> Bool:
    """Which (N,) dates and times state their own zone."""
    return np.asarray(pc.match_substring_regex(pc.utf8_trim_whitespace(text), r"(Z|UTC|:[0-9]{2}.*[+-][0-9:]+)$"))


def require_zone(tz: str) -> None:
    """Refuse a time zone that nobody knows.

    Raises:
        RecordingError: it is no IANA name.
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
    """Digits as int64; no digits are 0."""
    return np.asarray(pc.if_else(pc.equal(text, ""), "0", text).cast(pa.int64()))


def _wrong(rows: Rows, row: int, column: str, problem: str) -> RecordingError:
    return rows.error(
        row,
        column,
        problem,
        expected=_EXPECTED,
        remedy="correct or remove the row, or state the format: --option date_format=MM/DD/YYYY",
    )
