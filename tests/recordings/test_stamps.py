"""Dates and times as text, against Python's datetime and zoneinfo."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.stamps import parse_stamps
from mirror.recordings.tabular import RecordingRows

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def parse(*text: str, tz: str | None = "UTC", date_format: str | None = None) -> Int64:
    table = pa.table({"when": list(text)})
    rows = RecordingRows(table, (Path("drive.csv"),), (0,))
    return parse_stamps(rows, "when", table.column("when"), tz=tz, date_format=date_format)


def refusal(*text: str, tz: str | None = "UTC", date_format: str | None = None) -> str:
    with pytest.raises(RecordingError) as caught:
        parse(*text, tz=tz, date_format=date_format)
    assert caught.value.file == "drive.csv"
    return str(caught.value)


@given(
    st.datetimes(datetime(1971, 1, 1), datetime(2200, 1, 1)),
    st.sampled_from(["%Y-%m-%dT%H:%M:%S.%f", "%Y/%m/%d %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f"]),
    st.integers(-12 * 60, 14 * 60),
)
def test_stamps_with_an_offset_agree_with_datetime(moment: datetime, form: str, offset: int) -> None:
    date_format = {"%Y": None, "%m": "MM/DD/YYYY", "%d": "DD.MM.YYYY"}[form[:2]]
    zone = f"{'-' if offset < 0 else '+'}{abs(offset) // 60:02d}:{abs(offset) % 60:02d}"
    exact = (moment.replace(tzinfo=UTC) - EPOCH) // timedelta(microseconds=1) * 1_000 - offset * 60 * 10**9
    assert parse(moment.strftime(form) + zone, tz=None, date_format=date_format).tolist() == [exact]


@given(
    st.datetimes(datetime(2000, 1, 1), datetime(2036, 1, 1)), st.sampled_from(["Africa/Casablanca", "Asia/Shanghai"])
)
def test_local_time_agrees_with_zoneinfo(moment: datetime, zone: str) -> None:
    moment = moment.replace(microsecond=0)
    first, second = (moment.replace(tzinfo=ZoneInfo(zone), fold=fold) for fold in (0, 1))
    text = moment.strftime("%Y-%m-%d %H:%M:%S")
    if first.utcoffset() != second.utcoffset():
        assert "twice or not at all" in refusal(text, tz=zone)
    else:
        assert parse(text, tz=zone).tolist() == [int((first - EPOCH).total_seconds()) * 10**9]


def test_one_row_decides_the_order_for_all() -> None:
    assert parse("04/05/2021 00:00:00", "04/22/2021 00:00:00")[0] == parse("2021-04-05T00:00:00Z")[0]
    assert parse("04/05/2021 00:00:00", "22/04/2021 00:00:00")[0] == parse("2021-05-04T00:00:00Z")[0]


def test_undecided_order_is_refused() -> None:
    message = refusal("04/05/2021 00:00:00")
    assert "month first or day first" in message
    assert "date_format=MM/DD/YYYY" in message
    assert parse("04/05/2021 00:00", date_format="DD/MM/YYYY") == parse("2021-05-04T00:00Z")


def test_date_without_a_valid_order_decides_no_order() -> None:
    """A published dataset has such dates: they are bad rows, and give no order of day and month."""
    for wrong in ("90/02/2032 00:00:00", "30/00/2001 00:00:00", "03/00/2000 00:00:00", "02/00/2090 00:00:00"):
        table = pa.table({"when": ["04/05/2021 00:00:00", wrong, "04/22/2021 00:00:00"]})
        faults = RowFaults(3)
        rows = RecordingRows(table, (Path("drive.csv"),), (0,), (), faults)
        stamps = parse_stamps(rows, "when", table.column("when"), tz="UTC", date_format=None)
        assert faults.good.tolist() == [True, False, True]
        assert stamps[[0, 2]].tolist() == parse("2021-04-05T00:00:00Z", "2021-04-22T00:00:00Z").tolist()


def test_rows_that_contradict_each_other_are_refused() -> None:
    message = refusal("04/22/2021 00:00:00", "22/04/2021 00:00:00")
    assert "line 3" in message
    assert "line 2" in message


@pytest.mark.parametrize(
    "wrong",
    [
        "90/02/2032 10:00:00",
        "13/13/2021 10:00:00",
        "02/29/2021 10:00:00",
        "05/25/2021 24:00:00",
        "05/25/2021 10:60:00",
        "05/25/21 10:00:00",
        "yesterday",
        "",
        "05/25/2021",
    ],
)
def test_a_wrong_date_names_its_row_and_the_remedy(wrong: str) -> None:
    message = refusal("05/25/2021 10:00:00", wrong)
    assert "line 3, column when" in message
    assert repr(wrong) in message
    assert "Remedy" in message


def test_naive_stamps_need_a_zone() -> None:
    assert "--tz" in refusal("2021-04-05 10:00:00", tz=None)
    assert "unknown time zone" in str(refusal_of_zone())


def refusal_of_zone() -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        parse("2021-04-05 10:00:00", tz="Europe/Atlantis")
    return caught.value


def test_an_unknown_format_is_refused() -> None:
    with pytest.raises(RecordingError, match="not understood"):
        parse("2021-04-05 10:00:00", date_format="month/day")


def test_undecided_order_names_a_date_and_no_other_text() -> None:
    rows = RecordingRows(
        pa.table({"when": ["90/02/2032 00:00:00", "04/05/2021 00:00:00"]}), (Path("a.csv"),), (0,), (), RowFaults(2)
    )
    with pytest.raises(RecordingError, match="'04/05/2021 00:00:00'") as caught:
        parse_stamps(rows, "when", rows.table.column("when"), tz="UTC", date_format=None)
    assert caught.value.place == "line 3, column when"
