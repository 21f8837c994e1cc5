"""Calibrations of recordings: their validation and their table rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.recordings.calibration import Calibration, make_calibration, to_calibration_table
from mirror.schema.files import conform
from mirror.schema.tables import CALIBRATIONS

VALUES = {
    "model": "pinhole",
    "width_px": 64,
    "height_px": 48,
    "fx_px": 50.0,
    "fy_px": 51.0,
    "cx_px": 32.0,
    "cy_px": 24.0,
    "ego_SE3_camera": (0.5, -0.5, 0.5, -0.5, 1.5, 0.2, 1.6),
}


def made(**values: object) -> Calibration:
    return make_calibration(Path("calibration.json"), "front", **(VALUES | values))


def test_row_holds_the_values_of_the_calibration() -> None:
    covariance = tuple(float(value) for value in np.eye(6).ravel())
    calibration = made(covariance=covariance, valid_from_ns=5, valid_to_ns=5, time_offset_ns=-7, readout_ns=9)
    table = conform(
        to_calibration_table([("online", calibration)], vehicle_id="car", drive_id="d"), CALIBRATIONS, file="rows"
    )
    row = table.to_pylist()[0]
    pose = [row[name] for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")]
    assert pose == list(VALUES["ego_SE3_camera"])  # type: ignore[call-overload]
    assert row["covariance"] == list(covariance)
    assert (row["valid_from_ns"], row["valid_to_ns"], row["time_offset_ns"], row["readout_ns"]) == (5, 5, -7, 9)
    assert (row["vehicle_id"], row["drive_id"], row["camera"], row["stage"]) == ("car", "d", "front", "online")
    assert {name: row[name] for name in VALUES if name != "ego_SE3_camera"} == {
        name: value for name, value in VALUES.items() if name != "ego_SE3_camera"
    }


def test_nearly_unit_quaternion_is_normalised() -> None:
    pose = (0.5004, -0.5004, 0.5004, -0.5004, 0.0, 0.0, 0.0)
    row = to_calibration_table([("factory", made(ego_SE3_camera=pose))], vehicle_id="v", drive_id="d").to_pylist()[0]
    assert [row[name] for name in ("qw", "qx", "qy", "qz")] == pytest.approx([0.5, -0.5, 0.5, -0.5], abs=1e-15)


@pytest.mark.parametrize(
    ("values", "place"),
    [
        ({"covariance": (1.0,) * 35}, "covariance"),
        ({"covariance": (1.0,) * 37}, "covariance"),
        ({"covariance": (*(1.0,) * 35, float("nan"))}, "covariance"),
        ({"ego_SE3_camera": (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)}, "ego_SE3_camera"),
        ({"ego_SE3_camera": (1.0, *(0.0,) * 7)}, "ego_SE3_camera"),
        ({"width_px": 0}, "width_px"),
        ({"height_px": 2**31}, "height_px"),
        ({"time_offset_ns": 2**63}, "time_offset_ns"),
        ({"readout_ns": -1}, "readout_ns"),
        ({"fx_px": 0.0}, "fx, fy > 0"),
        ({"ego_SE3_camera": (1.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)}, "length 1.1, not 1"),
        ({"valid_from_ns": 6, "valid_to_ns": 5}, "after valid_to_ns"),
    ],
)
def test_invalid_calibrations_are_refused(values: dict[str, object], place: str) -> None:
    with pytest.raises(RecordingError) as caught:
        made(**values)
    assert place in str(caught.value)
    assert "camera front" in str(caught.value)


def test_largest_raster_and_offsets_are_accepted() -> None:
    widest = made(width_px=2**31 - 1, height_px=1, time_offset_ns=2**63 - 1, readout_ns=0)
    assert (widest.width_px, widest.height_px, widest.time_offset_ns) == (2**31 - 1, 1, 2**63 - 1)
