"""Tracks of GPX and NMEA files, and orientations in CSV."""

from __future__ import annotations

from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.geometry.quaternions import heading_deg
from mirror.recordings.registry import open_recording
from tests.recordings.assembly.tracks import GPX

START_NS = 1_772_359_200_000_000_000


def sentence(body: str) -> str:
    """A sentence of NMEA with its checksum."""
    return f"${body}*{reduce(xor, body.encode(), 0):02X}\r\n"


NMEA = (
    sentence("GNGGA,100000.00,5230.0000,N,01324.0000,E,4,12,0.8,40.5,M,39.5,M,,")
    + sentence("GNRMC,100000.00,A,5230.0000,N,01324.0000,E,10.0,90.0,010326,,,A")
    + sentence("GPRMC,100000.25,A,5230.0060,S,01324.0000,W,10.0,90.0,010326,,,A")
    + sentence("GNRMC,100000.50,V,,,,,,,010326,,,N")
    + sentence("GNRMC,100000.75,A,5230.0000,N,01324.0000,E,10.0,90.0,010326,,,A").replace("5230", "5231")
    + "noise\r\n"
)


def test_gpx(tmp_path: Path) -> None:
    (tmp_path / "a.gpx").write_text(GPX)
    recording = open_recording(tmp_path / "a.gpx", options={"vehicle_id": "car-7"})
    track = recording.track()
    assert (track.timestamp_ns - START_NS).tolist() == [0, 250_000_000]
    np.testing.assert_allclose(np.asarray(track.height_m), [40.5, 80.5])
    assert track.rotation is None and track.bad is not None and len(track.bad.before) == 1
    assert recording.info.vehicle_id == "car-7" and "sea level" in recording.info.notes[0]


def test_nmea(tmp_path: Path) -> None:
    (tmp_path / "a.nmea").write_text(NMEA)
    track = open_recording(tmp_path / "a.nmea").track()
    assert (track.timestamp_ns - START_NS).tolist() == [0, 250_000_000, 500_000_000]
    np.testing.assert_allclose(np.asarray(track.latitude_deg), [52.5, -52.5001, np.nan], atol=1e-9)
    np.testing.assert_allclose(np.asarray(track.longitude_deg), [13.4, -13.4, np.nan], atol=1e-9)
    np.testing.assert_allclose(np.asarray(track.height_m), [80.0, np.nan, np.nan])
    assert track.bad is not None and len(track.bad.before) == 1


@pytest.mark.parametrize(
    ("name", "text", "named"),
    [
        ("a.gpx", GPX[:200], "XML"),
        ("a.gpx", '<!DOCTYPE a [<!ENTITY x "y">]>' + GPX, "entities"),
        ("a.gpx", "<gpx/>", "trkpt"),
        ("a.gpx", '<gpx><trkpt lat="1" lon="2"/></gpx>', "no track point has a time"),
        ("a.nmea", "", "RMC"),
        ("a.nmea", NMEA.splitlines()[0], "RMC"),
    ],
)
def test_other_files_are_refused(name: str, text: str, named: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match=named):
        open_recording(tmp_path / name)


def test_a_csv_may_have_orientations(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(
        "timestamp_ns,lon,lat,heading_deg\n1772359200000000000,13.4,52.5,90\n1772359201000000000,13.4,52.5,\n"
    )
    track = open_recording(file).track()
    assert track.rotation is not None and heading_deg(track.rotation) == pytest.approx([90.0])
    assert track.bad is not None and len(track.bad.before) == 1
    file.write_text("timestamp_ns,lon,lat,qw,qx,qz\n1772359200000000000,13.4,52.5,1,0,0\n")
    with pytest.raises(RecordingError, match="qy"):
        open_recording(file).track()
