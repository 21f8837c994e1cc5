"""Images of rolling shutters: each row is a row of the view at its own time, to the last bit of its truth."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.geometry.rolling_shutter import RollingShutter
from mirror.synth import PRESETS, SynthDrive, make_drives, parse_readouts, write_recordings
from mirror.synth.render.scene import RollingImage
from mirror.synth.rigs import CameraReadout
from mirror.synth.truth.flow import rolling_flow

CAMERA, READOUT_NS = "front_wide", 60_000_000
AFTER_NS = 6_000_000_000


@pytest.fixture(autouse=True)
def _smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line of an image is rendered by itself: few and small images."""
    monkeypatch.setitem(PRESETS, "smaller", replace(PRESETS["tiny"], name="smaller", width_px=64, image_hz=0.05))


def _drive(direction: str) -> SynthDrive:
    drive = make_drives("smaller", 0)[1][0]
    readouts = (CameraReadout(CAMERA, direction, READOUT_NS),)  # type: ignore[arg-type]
    return replace(drive, vehicle=replace(drive.vehicle, readouts=readouts))


@pytest.mark.parametrize("direction", ["top_to_bottom", "right_to_left"])
def test_each_line_shows_the_world_at_its_own_time(direction: str) -> None:
    drive = _drive(direction)
    stamp = drive.condition.start_ns + AFTER_NS
    image = cast(RollingImage, drive.render(CAMERA, stamp))
    shutter = drive.vehicle.shutter(CAMERA)
    still = replace(drive, vehicle=replace(drive.vehicle, readouts=()))
    middle = still.render(CAMERA, stamp)
    for line in (0, shutter.lines // 3, shutter.lines // 2, shutter.lines - 1):
        offset_ns = (line / (shutter.lines - 1) - 0.5) * READOUT_NS * (1 if direction == "top_to_bottom" else -1)
        there = still.render(CAMERA, stamp + round(offset_ns))
        at = (slice(None), line) if direction == "right_to_left" else (line,)
        same = np.isclose(image.view.distance_m[at], there.view.distance_m[at], rtol=1e-4) | (
            np.isinf(image.view.distance_m[at]) & np.isinf(there.view.distance_m[at])
        )
        assert same.mean() > 0.99
        assert (image.view.label[at] == there.view.label[at]).mean() > 0.99
        assert (image.view.object[at] == there.view.object[at]).mean() > 0.99
        both = image.bgr[at].astype(int) - there.bgr[at].astype(int)
        assert np.abs(both).mean() < 12.0  # noise differs
    finite = np.isfinite(image.view.distance_m) & np.isfinite(middle.view.distance_m)
    still_there = np.isclose(image.view.distance_m, middle.view.distance_m, rtol=1e-3)[finite]
    assert 0.2 < still_there.mean() < 0.95


def test_flow_ends_at_the_line_that_sees_the_point_later() -> None:
    drive = _drive("top_to_bottom")
    stamp = drive.condition.start_ns + AFTER_NS
    image = cast(RollingImage, drive.render(CAMERA, stamp))
    camera, shutter = drive.vehicle.cameras[CAMERA], drive.vehicle.shutter(CAMERA)
    poses_at = partial(drive.poses_about, CAMERA)
    later = stamp + 100_000_000
    flow = rolling_flow(image.view.distance_m, camera, shutter, partial(poses_at, stamp), partial(poses_at, later))
    checked = 0
    for row, column in ((camera.height_px - 4, 8), (camera.height_px // 2 + 3, 16), (camera.height_px - 2, 36)):
        start = poses_at(stamp, shutter.line_offsets_ns()[row : row + 1])
        ray = camera.rays().direction[row, column]
        point = start.transform(image.view.distance_m[row, column] * ray[None]).reshape(3)
        low, high = -0.6 * READOUT_NS, 0.6 * READOUT_NS
        for _ in range(60):
            time = 0.5 * (low + high)
            seen = camera.project(poses_at(later, np.array([time])).inverse().transform(point[None])[0]).uv_px
            low, high = (time, high) if shutter.offsets_ns(seen)[0] > time else (low, time)
        expected = seen.reshape(2) - (column + 0.5, row + 0.5)
        if np.isfinite(expected).all() and abs(low) < 0.59 * READOUT_NS:
            np.testing.assert_allclose(flow[row, column], expected, atol=1e-3)
            checked += 1
    assert checked >= 1


def test_a_recording_states_the_shutters_and_widens_exposures(tmp_path: Path) -> None:
    out = tmp_path / "recordings"
    write_recordings(
        out, "smaller", traversals=1, readouts=parse_readouts("front_wide=top_to_bottom:30,rear=left_to_right:12.5"),
        truth=("depth", "flow"), workers=2,
    )  # fmt: skip
    recording = next(path for path in out.iterdir() if (path / "calibrations").is_dir())
    calibrations = json.loads((recording / "calibrations" / "factory.json").read_text())
    stated = {row["camera"]: (row["shutter_direction"], row["readout_ns"]) for row in calibrations}
    assert stated["front_wide"] == ("top_to_bottom", 30_000_000)
    assert stated["rear"] == ("left_to_right", 12_500_000)
    assert stated["front_left"] == ("global", 0)
    _, line, *_ = (recording / "images" / "front_wide.csv").read_text().splitlines()
    name, start, end = line.split(",")
    assert int(end) - int(start) > 30_000_000
    assert abs((int(start) + int(end)) // 2 - int(name.removesuffix(".jpg"))) <= 1


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("top_to_bottom", "no readout in"),
        ("down:30", "no direction 'down'"),
        ("front=top_to_bottom:30", "no camera 'front'"),
        ("rear=top_to_bottom:30,rear=left_to_right:30", "two shutters of camera rear"),
        ("top_to_bottom:-3", "a readout of '-3'"),
        ("top_to_bottom:25000", "is read out in 25000 ms"),
    ],
)
def test_shutters_that_cannot_be_are_refused(text: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=problem) as caught:
        write_recordings(tmp_path / "out", "smaller", readouts=parse_readouts(text))
    assert caught.value.place == "--rolling-shutter"
    assert not (tmp_path / "out").exists()


def test_a_raster_of_one_row_has_no_rows_to_read_out() -> None:
    with pytest.raises(UsageError, match="is not read out top_to_bottom"):
        RollingShutter("top_to_bottom", 30_000_000, 640, 1)
    with pytest.raises(UsageError, match="no shutter direction"):
        RollingShutter("downwards", 30_000_000, 640, 480)  # type: ignore[arg-type]
