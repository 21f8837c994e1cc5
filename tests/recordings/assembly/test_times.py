"""Times of images: names, EXIF data of a file that OpenCV wrote, tables."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.recordings.assembly.exif import read_exif_time
from mirror.recordings.assembly.times import image_times, parse_time, table_times

START_NS = 1_772_359_200_000_000_000


def exif_jpeg(time: str, fraction: str = "", offset: str = "", order: str = "<") -> bytes:
    """A JPEG with DateTimeOriginal, SubSecTimeOriginal and OffsetTimeOriginal, written by hand from the standard."""
    texts = {0x9003: time, 0x9011: offset, 0x9291: fraction}
    values = {tag: text.encode() + b"\0" for tag, text in texts.items() if text}
    head = struct.pack(f"{order}2sHI", b"II" if order == "<" else b"MM", 42, 8)
    main = struct.pack(f"{order}HHHIII", 1, 0x8769, 4, 1, 26, 0)
    place = 26 + 2 + 12 * len(values) + 4
    entries, data = struct.pack(f"{order}H", len(values)), b""
    for tag, value in values.items():
        if len(value) <= 4:
            entries += struct.pack(f"{order}HHI", tag, 2, len(value)) + value.ljust(4, b"\0")
        else:
            entries += struct.pack(f"{order}HHII", tag, 2, len(value), place + len(data))
            data += value
    body = b"Exif\0\0" + head + main + entries + struct.pack(f"{order}I", 0) + data
    encoded = cv2.imencode(".jpg", np.zeros((6, 8, 3), np.uint8))[1].tobytes()
    return encoded[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2) + body + encoded[2:]


def test_exif(tmp_path: Path) -> None:
    whole, little = exif_jpeg("2026:03:01 11:00:00"), exif_jpeg("2026:03:01 11:00:00", "25", "+01:00")
    assert read_exif_time(whole) == "2026-03-01 11:00:00"
    assert read_exif_time(little) == "2026-03-01 11:00:00.25 +01:00"
    assert read_exif_time(exif_jpeg("2026:03:01 11:00:00", "2501", "+01:00", ">")) == "2026-03-01 11:00:00.2501 +01:00"
    for odd in (b"", b"\xff\xd8", whole[:40], exif_jpeg("0000"), cv2.imencode(".jpg", np.zeros((6, 8)))[1].tobytes()):
        assert read_exif_time(odd) is None
    (tmp_path / "a.jpg").write_bytes(little)
    assert image_times(tmp_path, ["a.jpg"], None).start_ns.tolist() == [START_NS + 250_000_000]
    (tmp_path / "b.jpg").write_bytes(whole)
    found = image_times(tmp_path, ["b.jpg"], "Europe/Berlin")
    assert found.start_ns.tolist() == [START_NS] and "whole seconds" in found.source
    with pytest.raises(RecordingError, match="unknown zone"):
        image_times(tmp_path, ["b.jpg"], None)
    (tmp_path / "c.jpg").write_bytes(whole)
    with pytest.raises(RecordingError, match="repeat"):
        image_times(tmp_path, ["b.jpg", "c.jpg"], "Europe/Berlin")


@pytest.mark.parametrize(
    ("name", "stamp"),
    [
        ("1772359200000000001.jpg", START_NS + 1),
        ("front_1772359200000001.jpg", START_NS + 1_000),
        ("1772359200001.jpg", START_NS + 1_000_000),
        ("1772359200.5.jpg", START_NS + 500_000_000),
        ("IMG_20260301_110000250.jpg", START_NS + 250_000_000),
        ("2026-03-01T11-00-00.jpg", START_NS),
        ("2026-03-01_10.00.00.125Z.png", START_NS + 125_000_000),
    ],
)
def test_names(name: str, stamp: int, tmp_path: Path) -> None:
    found = image_times(tmp_path, [name], "Europe/Berlin")
    assert found.start_ns.tolist() == [stamp] and "names" in found.source


def test_what_states_no_time_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a1.jpg").write_bytes(b"\xff\xd8")
    with pytest.raises(RecordingError, match="EXIF"):
        image_times(tmp_path, ["a1.jpg"], None)
    with pytest.raises(RecordingError):
        parse_time("yesterday", None, "--start front")
    assert parse_time("2026-03-01T10:00:00.25Z", None, "--start front") == START_NS + 250_000_000
    assert parse_time(str(START_NS), None, "") == START_NS


def test_tables(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text(f"file,exposure_start_ns,exposure_end_ns\na.jpg,{START_NS},{START_NS + 2}\n")
    found = table_times(table, "file", None)
    assert (found.names, found.start_ns.tolist(), found.end_ns.tolist()) == (("a.jpg",), [START_NS], [START_NS + 2])
    table.write_text("frame,timestamp\n0,2026-03-01 11:00:00.5\n")
    assert table_times(table, "frame", "Europe/Berlin").start_ns.tolist() == [START_NS + 500_000_000]
    table.write_text("name,when\na.jpg,1\n")
    with pytest.raises(RecordingError, match="file and timestamp_ns"):
        table_times(table, "file", None)
