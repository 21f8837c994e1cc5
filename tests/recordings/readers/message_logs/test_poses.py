"""Poses from odometry, from transforms and from fixes without an orientation; stamps; bad rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mirror.errors import RecordingError
from tests.recordings.readers.message_logs.drives import ONE, opened, require_same_track
from tests.recordings.readers.message_logs.writer import TOPICS, Out, messages, write_mcap

CAMERA = TOPICS[TOPICS.index("[cameras") :]
LOCAL = """
[pose]
{pose}
"""


@pytest.mark.parametrize(
    ("position", "pose", "frame"),
    [
        ("odometry", 'topic = "/odom"', "city"),
        ("odometry", 'topic = "/odom"\nframe = "garching"', "garching"),
        ("transforms", 'transform = ["map", "base_link"]', "map"),
    ],
)
def test_local_poses_are_those_of_the_ego(tmp_path: Path, position: str, pose: str, frame: str) -> None:
    write_mcap(tmp_path / "log.mcap", messages(ONE, position=position))  # type: ignore[arg-type]
    recording = opened(tmp_path, LOCAL.format(pose=pose) + CAMERA)
    track = recording.track()
    assert (recording.info.frame, recording.info.body_frame) == (frame, "ego")
    np.testing.assert_array_equal(track.timestamp_ns, ONE.stamps)
    position_m = np.stack([np.asarray(track.x_m), np.asarray(track.y_m), np.asarray(track.height_m)], axis=1)
    np.testing.assert_allclose(position_m, ONE.frame_SE3_ego.translation, atol=1e-9)
    same = np.einsum("ij,ij->i", np.asarray(track.rotation), ONE.frame_SE3_ego.rotation)
    np.testing.assert_allclose(np.abs(same), 1.0, atol=1e-12)


def test_transforms_in_a_chain_are_interpolated(tmp_path: Path) -> None:
    """``map`` to ``odom`` twice, far apart and turning slowly; ``odom`` to ``base_link`` at every stamp."""
    every = messages(ONE, position="transforms")
    for message in every:
        if message.topic == "/tf":
            message.value.transforms[0].header.frame_id = "odom"
    for row, yaw in ((0, 0.0), (len(ONE.stamps) - 1, 0.4)):
        stamp = int(ONE.stamps[row])
        turn = SimpleNamespace(w=np.cos(yaw / 2), x=0.0, y=0.0, z=np.sin(yaw / 2))
        shift = SimpleNamespace(x=10.0 + row, y=0.0, z=0.0)
        header = SimpleNamespace(stamp=SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="map")
        value = SimpleNamespace(
            transforms=[
                SimpleNamespace(
                    header=header,
                    child_frame_id="odom",
                    transform=SimpleNamespace(translation=shift, rotation=turn),
                )
            ]
        )
        every.append(Out("/tf", "tf2_msgs/msg/TFMessage", stamp, value))
    write_mcap(tmp_path / "log.mcap", every)
    track = opened(tmp_path, LOCAL.format(pose='transform = ["map", "base_link"]')).track()
    share = (ONE.stamps - ONE.stamps[0]) / (ONE.stamps[-1] - ONE.stamps[0])
    yaw = 0.4 * share
    x, y, _ = ONE.frame_SE3_ego.translation.T
    expected_x = 10.0 + share * (len(ONE.stamps) - 1) + np.cos(yaw) * x - np.sin(yaw) * y
    np.testing.assert_allclose(np.asarray(track.x_m), expected_x, atol=1e-9)
    np.testing.assert_allclose(np.asarray(track.y_m), np.sin(yaw) * x + np.cos(yaw) * y, atol=1e-9)


def test_fixes_without_an_orientation_stay_those_of_the_antenna(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap", messages(ONE))
    recording = opened(tmp_path, '[pose]\ntopic = "/fix"\n')
    track = recording.track()
    assert track.rotation is None and recording.info.body_frame == "gps_antenna" and recording.rig is None
    assert len(track) == len(ONE.stamps)


def test_fixes_of_a_receiver_without_a_position_are_bad_rows(tmp_path: Path) -> None:
    every = messages(ONE)
    fixes = [message for message in every if message.topic == "/fix"]
    fixes[3].value.status.status = -1
    fixes[9].value.latitude = float("nan")
    write_mcap(tmp_path / "log.mcap", every)
    track = opened(tmp_path).track()
    assert track.bad is not None and track.bad.counts() == {"number": 2}
    assert str(fixes[3].stamp) in str(track.bad.first)
    kept = np.delete(np.arange(len(ONE.stamps)), [3, 9])
    np.testing.assert_array_equal(track.timestamp_ns, ONE.stamps[kept])


def test_orientations_are_interpolated_and_missing_ones_are_bad_rows(tmp_path: Path) -> None:
    every = messages(ONE)
    turns = [message for message in every if message.topic == "/imu"]
    gone = {id(message) for message in turns[:4]} | {id(message) for message in turns[20:120:2]}
    write_mcap(tmp_path / "log.mcap", [message for message in every if id(message) not in gone])
    track = opened(tmp_path).track()
    assert track.bad is not None and track.bad.counts() == {"rotation": 4}
    truth = ONE.truth()
    heading = np.asarray(truth.rotation)[4:]
    same = np.abs(np.einsum("ij,ij->i", np.asarray(track.rotation), heading))
    assert 2 * np.degrees(np.arccos(np.clip(same, 0, 1))).max() < 0.02


def test_stamps_of_logging(tmp_path: Path) -> None:
    late = [replace(message, stamp=message.stamp + 40_000_000) for message in messages(ONE)]
    write_mcap(tmp_path / "log.mcap", late)
    np.testing.assert_array_equal(opened(tmp_path).track().timestamp_ns, ONE.stamps)
    recording = opened(tmp_path, 'stamps = "log"\n' + TOPICS)
    np.testing.assert_array_equal(recording.track().timestamp_ns, ONE.stamps + 40_000_000)
    np.testing.assert_array_equal(recording.images()["front_wide"].exposure_start_ns, ONE.image_stamps + 40_000_000)


def test_a_log_without_a_clock_is_refused_with_the_way_out(tmp_path: Path) -> None:
    every = messages(ONE)
    for message in every:
        if message.topic == "/fix":
            message.value.header.stamp.sec -= 1_700_000_000
    write_mcap(tmp_path / "log.mcap", every)
    with pytest.raises(RecordingError, match="no Unix time") as caught:
        opened(tmp_path).track()
    assert 'stamps = "log"' in str(caught.value)
    require_same_track(opened(tmp_path, 'stamps = "log"\n' + TOPICS).track(), ONE.truth())


def test_a_mounting_that_moves_is_refused(tmp_path: Path) -> None:
    every = messages(ONE)
    again = [message for message in messages(ONE) if message.topic == "/tf_static"]
    for message in again:
        message.value.transforms[0].transform.translation.x += 0.05
    write_mcap(tmp_path / "log.mcap", every + again)
    with pytest.raises(RecordingError, match="changes over time"):
        opened(tmp_path).track()


def test_a_changed_lens_gives_another_calibration(tmp_path: Path) -> None:
    every = messages(ONE)
    infos = [message for message in every if message.topic == "/front/camera_info"]
    for message in infos[5:]:
        message.value.k[0] = 55.0
    write_mcap(tmp_path / "log.mcap", every)
    rows = opened(tmp_path).calibrations().to_pylist()
    changed = infos[5].stamp
    assert [(row["fx_px"], row["valid_from_ns"], row["valid_to_ns"]) for row in rows] == [
        (50.0, None, changed - 1),
        (55.0, changed, None),
    ]
