"""The topics file: its proposal, what it refuses, and `mirror info` and `mirror ingest` of a log."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode, RecordingError
from mirror.geometry.cameras import Camera
from mirror.recordings.lens_files import write_lens
from mirror.recordings.readers.message_logs.container import Topic
from mirror.recordings.readers.message_logs.topics_file import TopicsFile, propose_topics
from mirror.recordings.registry import open_recording
from tests.builders.folder import LAT, LON
from tests.recordings.readers.message_logs.drives import ONE, opened, require_drive
from tests.recordings.readers.message_logs.writer import TOPICS, messages, write_mcap


def test_from_the_proposal_to_a_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_mcap(tmp_path / "monday.mcap", messages(ONE))
    # As in `mirror info LOG > LOG.toml`.
    (tmp_path / "monday.toml").touch()
    assert main(["info", str(log)]) == ExitCode.DONE
    proposal = capsys.readouterr().out
    assert proposal.startswith(f"# Save as {tmp_path / 'monday.toml'}\n")
    (tmp_path / "monday.toml").write_text(proposal)
    assert main(["info", str(log)]) == ExitCode.DONE
    assert "camera front" in capsys.readouterr().out
    out = tmp_path / "d"
    assert main(["ingest", str(log), "--roi", f"{LON},{LAT},150", "--out", str(out)]) == ExitCode.DONE
    (traversal,) = (out / "traversals").iterdir()
    assert len(list((traversal / "recorded" / "front").iterdir())) == len(ONE.images)


def test_the_proposal_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_mcap(tmp_path / "monday.mcap", messages(ONE))
    main(["info", str(log), "--json"])
    found = tomllib.loads(json.loads(capsys.readouterr().out)["configuration"])
    assert found["pose"] == {"topic": "/fix", "orientation": "/imu"}


def test_a_proposal_is_a_topics_file_and_names_cameras(tmp_path: Path) -> None:
    kinds = {
        "/sensing/camera/front_wide/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
        "/sensing/camera/front_wide/camera_info": "sensor_msgs/msg/CameraInfo",
        "/sensing/camera/rear/video": "foxglove_msgs/msg/CompressedVideo",
        "/sensing/camera/rear/camera_info": "sensor_msgs/msg/CameraInfo",
        "/sensing/camera/traffic_light/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
        "/sensing/camera/traffic_light/image_raw": "sensor_msgs/msg/Image",
        "/sensing/lidar/points": "sensor_msgs/msg/PointCloud2",
        "/localization/odometry": "nav_msgs/msg/Odometry",
        "/gnss/fix": "sensor_msgs/msg/NavSatFix",
    }
    text = propose_topics({name: Topic(name, kind, "cdr") for name, kind in kinds.items()}, "monday 8 am")
    document = TopicsFile.model_validate(tomllib.loads(text))
    assert document.drive_id == "monday_8_am" and document.reference_camera == "front_wide"
    assert (document.pose.topic, document.pose.orientation) == ("/gnss/fix", "/localization/odometry")
    assert {name: entry.info for name, entry in document.cameras.items()} == {
        "front_wide": "/sensing/camera/front_wide/camera_info",
        "rear": "/sensing/camera/rear/camera_info",
        "traffic_light": None,
    }
    assert '# topic = "/localization/odometry"' in text
    assert "not compressed: /sensing/camera/traffic_light/image_raw\n" in text


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("x = [", "", "is not TOML"),
        ('[pose]\ntopic = "/fix"\nspeed = 3\n', "pose.speed", "not known"),
        ("[pose]\n", "pose", "exactly one of topic and transform"),
        ('[pose]\ntopic = "/nothing"\n', "pose.topic", "no topic '/nothing'"),
        ('[pose]\ntopic = "/imu"\n', "pose.topic", "has the type sensor_msgs/msg/Imu"),
        (TOPICS.replace("/front/camera_info", "/fix"), "cameras.front_wide.info", "has the type"),
        ('stamps = "gps"\n' + TOPICS, "stamps", "'header' or 'log'"),
        ('reference_camera = "rear"\n' + TOPICS, "the whole document", "reference_camera is none"),
        ('[pose]\ntransform = ["map", "base_link"]\n', "pose.transform", "no chain of transforms"),
        ('ego_frame = "nowhere"\n' + TOPICS, "camera front_wide", "no chain of transforms leads from 'nowhere'"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, place: str, words: str) -> None:
    write_mcap(tmp_path / "log.mcap", messages(ONE))
    with pytest.raises(RecordingError, match=words) as caught:
        recording = opened(tmp_path, text)
        recording.track()
        recording.calibrations()
    assert place in str(caught.value.place or "")


def test_raw_images_and_unknown_encodings_are_refused_by_name(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        for number, (kind, encoding) in enumerate(
            (("sensor_msgs/msg/Image", "cdr"), ("sensor_msgs/NavSatFix", "ros1"))
        ):
            schema = writer.register_schema(kind, "ros1msg" if encoding == "ros1" else "ros2msg", b"int8 x")
            channel = writer.register_channel(f"/t{number}", encoding, schema)
            writer.add_message(channel, ONE.image_stamps.tolist()[0], b"\0" * 40, 0)
        writer.finish()
    with pytest.raises(RecordingError, match="image_transport"):
        opened(tmp_path, '[pose]\ntopic = "/t1"\n[cameras.a]\nimages = "/t0"\n')
    with pytest.raises(RecordingError, match="encoded as ros1"):
        track = opened(tmp_path, '[pose]\ntopic = "/t1"\n')
        raise track._contents.damage[0]


def test_a_missing_topics_file_is_named(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", messages(ONE))
    from mirror.recordings.registry import open_recording

    with pytest.raises(RecordingError, match="no topics file") as caught:
        open_recording(log)
    assert f"mirror info {log}" in str(caught.value) and caught.value.expected == str(tmp_path / "log.toml")
    (tmp_path / "elsewhere.toml").write_text(TOPICS)
    recording = open_recording(log, options={"topics": str(tmp_path / "elsewhere.toml")})
    require_drive(recording, ONE)  # type: ignore[arg-type]


def test_a_topic_of_several_types_is_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    stamp = int(ONE.stamps[0])

    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        for kind in ("a/A", "b/B"):
            schema = writer.register_schema(kind, "ros2msg", b"int8 x")
            writer.add_message(writer.register_channel("/same", "cdr", schema), stamp, b"\0" * 8, stamp)
        writer.finish()
    with pytest.raises(RecordingError, match="has the types a/A"):
        opened(tmp_path)


def test_all_faults_of_a_topics_file_are_listed(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", messages(ONE))
    (tmp_path / "a.toml").write_text('stamps = "gps"\nspeed = 3\n[pose]\n')
    with pytest.raises(RecordingError, match="3 faults") as refused:
        open_recording(tmp_path / "a.mcap").track()
    assert refused.value.place is not None and {"stamps", "speed", "pose"} == set(refused.value.place.split(", "))
    (tmp_path / "a.toml").write_text('[pose]\ntopic = "/imu"\n[cameras.rear]\nimages = "/nothing"\n')
    with pytest.raises(RecordingError, match="2 faults") as refused:
        open_recording(tmp_path / "a.mcap").track()
    assert refused.value.place == "pose.topic, cameras.rear.images"


def test_a_lens_and_a_mounting_of_the_topics_file(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", messages(ONE))
    lens = Camera("pinhole", 64, 48, 50.0, 50.0, 32.0, 24.0)
    write_lens(tmp_path / "lens.yaml", lens)
    own = 'lens = "lens.yaml"\nmounting = [1.5, 0, 1.4, 0, 0, 0]'
    (tmp_path / "a.toml").write_text(re.sub(r'info = "[^"]*"', own, TOPICS))
    recording = open_recording(tmp_path / "a.mcap")
    (row,) = recording.calibrations().to_pylist()
    assert (row["fx_px"], row["cx_px"], row["tx_m"], row["tz_m"]) == (50.0, 32.0, 1.5, 1.4)
    assert "lens.yaml" in dict(recording.files())
    (tmp_path / "a.toml").write_text(TOPICS + "mounting = [2.5, 0, 1.4, 0, 0, 0]\n")
    (row,) = open_recording(tmp_path / "a.mcap").calibrations().to_pylist()
    assert row["tx_m"] == 2.5


def test_a_log_has_masks_of_the_vehicle_and_the_front_camera_as_reference(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap", messages(ONE))
    drawn = np.zeros((48, 64), np.uint8)
    drawn[40:] = 255
    cv2.imwrite(str(tmp_path / "bonnet.png"), drawn)
    entry = '[cameras.{name}]\nimages = "/front/image/compressed"\n'
    pose = '[pose]\ntopic = "/fix"\n'
    text = pose + entry.format(name="a_side") + entry.format(name="front_wide") + 'static_mask = "bonnet.png"\n'
    recording = opened(tmp_path, text)
    assert recording.rig is not None and recording.rig.reference_camera == "front_wide"
    side, front = recording.rig.cameras
    assert side.static_mask is None and front.static_mask is not None
    np.testing.assert_array_equal(front.static_mask, drawn)
    assert "bonnet.png" in [name for name, _ in recording.files()]
    for name, words in (("absent.png", "take static_mask out of log.toml"), ("../x.png", "leads out")):
        with pytest.raises(RecordingError) as refused:
            assert opened(tmp_path, pose + entry.format(name="a") + f'static_mask = "{name}"\n').rig
        assert words in str(refused.value), str(refused.value)
