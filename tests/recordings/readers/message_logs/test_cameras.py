"""Intrinsics of windows, binned and uncalibrated cameras, and images that share a stamp."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode, RecordingError
from mirror.geometry.cameras import camera_from_row
from mirror.recordings.protocol import repeated_stamps
from mirror.recordings.readers.message_logs.contents import read_contents
from mirror.recordings.summary import summarise
from tests.builders.folder import LAT, LON
from tests.recordings.readers.message_logs.drives import ONE, opened
from tests.recordings.readers.message_logs.films import VIDEO, packets, video_messages
from tests.recordings.readers.message_logs.writer import TOPICS, Out, messages, write_mcap


def with_info(**changes: Any) -> list[Out]:
    """The messages of a drive, with other values in its CameraInfo; the images are 64 x 48 px."""
    every = messages(ONE)
    for message in every:
        if message.topic != "/front/camera_info":
            continue
        for name, value in changes.items():
            if isinstance(value, dict):
                vars(getattr(message.value, name)).update(value)
            else:
                setattr(message.value, name, value)
    return every


FULL = (100.0, 0.0, 75.0, 0.0, 102.0, 60.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("changes", "offset", "binning"),
    [
        (
            {"width": 200, "height": 160, "roi": {"x_offset": 30, "y_offset": 20, "width": 64, "height": 48}},
            (30, 20),
            1,
        ),
        ({"width": 128, "height": 96, "binning_x": 2, "binning_y": 2}, (0, 0), 2),
        (
            {
                "width": 300,
                "height": 200,
                "binning_x": 2,
                "binning_y": 2,
                "roi": {"x_offset": 10, "y_offset": 8, "width": 128, "height": 96},
            },
            (10, 8),
            2,
        ),
        # A window of the whole sensor, and a binning of 1, change nothing.
        ({"width": 64, "height": 48, "binning_x": 1, "binning_y": 1, "roi": {"width": 64, "height": 48}}, (0, 0), 1),
    ],
)
def test_windows_and_binning_move_and_scale_the_intrinsics(
    changes: dict[str, Any], offset: tuple[int, int], binning: int, tmp_path: Path
) -> None:
    """A point lies where image_geometry puts it: the pixel of the full sensor, less the window, divided by binning."""
    write_mcap(tmp_path / "log.mcap", with_info(k=list(FULL), **changes))
    (row,) = opened(tmp_path).calibrations().to_pylist()
    assert (row["width_px"], row["height_px"]) == (64, 48)
    points = np.array([[0.05, -0.1, 1.0], [-0.2, 0.15, 1.0], [0.0, 0.0, 1.0]])
    found = camera_from_row(row).project(points).uv_px
    write_mcap(tmp_path / "log.mcap", with_info(k=list(FULL), width=400, height=300))
    (full,) = opened(tmp_path).calibrations().to_pylist()
    whole = camera_from_row(full).project(points).uv_px - 0.5
    np.testing.assert_allclose(found, (whole - offset) / binning + 0.5, atol=1e-9)
    # The dataset takes the images: their size is that of the calibration.
    write_mcap(tmp_path / "log.mcap", with_info(k=list(FULL), **changes))
    arguments = ["ingest", str(tmp_path / "log.mcap"), "--roi", f"{LON},{LAT},150", "--out", str(tmp_path / "d")]
    assert main(arguments) == ExitCode.DONE


def test_a_window_that_changes_gives_another_calibration(tmp_path: Path) -> None:
    every = with_info(width=200, height=160, roi={"x_offset": 30, "y_offset": 20, "width": 64, "height": 48})
    infos = [message for message in every if message.topic == "/front/camera_info"]
    for message in infos[4:]:
        message.value.roi.x_offset = 40
    write_mcap(tmp_path / "log.mcap", every)
    rows = opened(tmp_path).calibrations().to_pylist()
    assert [row["valid_from_ns"] for row in rows] == [None, infos[4].stamp]
    assert rows[1]["cx_px"] == rows[0]["cx_px"] - 10.0


def test_a_window_beyond_the_sensor_is_named(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap", with_info(roi={"x_offset": 30, "y_offset": 0, "width": 64, "height": 48}))
    recording = opened(tmp_path)
    errors = read_contents(recording.logs, recording.document).damage
    assert len(errors) == len(ONE.images) and "leaves the sensor" in str(errors[0])


def test_a_camera_info_of_zeros_is_an_uncalibrated_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_mcap(tmp_path / "log.mcap", with_info(k=[0.0] * 9, d=[], distortion_model=""))
    recording = opened(tmp_path)
    assert recording.calibrations().num_rows == 0
    assert not summarise(recording).cameras["front_wide"].is_calibrated
    assert main(["info", str(log)]) == ExitCode.DONE
    assert "uncalibrated" in capsys.readouterr().out
    out = tmp_path / "d"
    assert main(["ingest", str(log), "--roi", f"{LON},{LAT},150", "--out", str(out)]) == ExitCode.DONE
    assert "uncalibrated" in capsys.readouterr().out
    document = json.loads((out / "drives" / "drive" / "drive.json").read_text())
    assert document["uncalibrated_cameras"] == ["front_wide"]
    assert main(["check", str(out)]) == ExitCode.DONE


def test_a_camera_that_is_calibrated_later_has_a_calibration(tmp_path: Path) -> None:
    every = messages(ONE)
    first = next(message for message in every if message.topic == "/front/camera_info")
    first.value.k = [0.0] * 9
    write_mcap(tmp_path / "log.mcap", every)
    recording = opened(tmp_path)
    assert recording.calibrations().num_rows == 1
    assert recording.rig is not None and recording.rig.cameras[0].is_calibrated


def test_images_with_one_stamp_are_counted_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    every = messages(ONE)
    images = [message for message in every if message.topic == "/front/image/compressed"]
    stamp = images[3].stamp
    images[4].value.header.stamp = images[3].value.header.stamp
    log = write_mcap(tmp_path / "log.mcap", every)
    stream = opened(tmp_path).images()["front_wide"]
    assert len(stream.exposure_start_ns) == len(ONE.images) - 1
    assert repeated_stamps(stream).tolist() == [stamp]
    assert main(["info", str(log)]) == ExitCode.DONE
    assert f"1 left out with the stamp of another, first {stamp}" in capsys.readouterr().out
    out = tmp_path / "d"
    arguments = ["ingest", str(log), "--roi", f"{LON},{LAT},150", "--out", str(out)]
    assert main([*arguments, "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["images_repeated"] == {"front_wide": 1}
    assert json.loads((out / "drives" / "drive" / "drive.json").read_text())["images_repeated"] == 1
    assert main([*arguments, "--replace"]) == ExitCode.DONE


def test_packets_with_one_stamp_are_refused(tmp_path: Path) -> None:
    """Leaving a packet out would damage the frames that are decoded after it."""
    film = video_messages(packets(tmp_path, "h264"), "h264")
    film[7].value.header.stamp = film[7].value.timestamp = film[6].value.header.stamp
    write_mcap(tmp_path / "log.mcap", messages(ONE) + film)
    with pytest.raises(RecordingError, match="packets") as caught:
        opened(tmp_path, TOPICS + VIDEO).images()
    assert str(film[6].stamp) in str(caught.value.place)


def test_repeated_transforms_are_counted_as_poses(tmp_path: Path) -> None:
    from mirror.ingest.clean import clean
    from mirror.schema.documents import CleaningOptions

    every = messages(ONE, position="transforms")
    moving = [message for message in every if message.topic == "/tf"]
    write_mcap(tmp_path / "log.mcap", every + moving[20:23])
    text = TOPICS.replace('topic = "/fix"\norientation = "/imu"', 'transform = ["map", "base_link"]')
    track = opened(tmp_path, text).track()
    assert len(track) == len(ONE.stamps) + 3
    assert clean(track, CleaningOptions())[1].duplicate_time == 3
