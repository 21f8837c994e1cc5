"""One drive in every container and encoding: the same poses, calibrations and images, equal to the truth."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType

from mirror.recordings.readers.message_logs.mcap_file import McapFile
from mirror.recordings.readers.message_logs.recording import LogRecording
from mirror.recordings.registry import open_recording
from tests.recordings.readers.message_logs.drives import ONE, opened, require_drive
from tests.recordings.readers.message_logs.writer import TOPICS, messages, write_mcap, write_rosbag2

CASES = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "not compressed": {"compression": CompressionType.NONE},
    "not chunked": {"chunked": False},
    "not chunked, no index": {"chunked": False, "indexed": False},
    "no index": {"indexed": False},
    "one large chunk": {"chunk_bytes": 2**24},
    "protobuf": {"encoding": "protobuf"},
    "json": {"encoding": "json"},
}


@pytest.mark.parametrize("case", CASES)
def test_the_same_drive_from_every_mcap_file(tmp_path: Path, case: str) -> None:
    write_mcap(tmp_path / "log.mcap", messages(ONE), **CASES[case])  # type: ignore[arg-type]
    recording = opened(tmp_path)
    assert recording.info.body_frame == "ego" and recording.info.frame is None
    require_drive(recording, ONE)


@pytest.mark.parametrize("definitions", [True, False])
def test_the_same_drive_from_rosbag2(tmp_path: Path, definitions: bool) -> None:
    write_rosbag2(tmp_path / "log.db3", messages(ONE), definitions=definitions)
    require_drive(opened(tmp_path), ONE)


@pytest.mark.parametrize("chunked", [True, False])
def test_the_order_of_storage_does_not_matter(tmp_path: Path, chunked: bool) -> None:
    shuffled = messages(ONE)
    np.random.default_rng(3).shuffle(shuffled)  # type: ignore[arg-type]
    write_mcap(tmp_path / "log.mcap", shuffled, chunked=chunked)
    recording = opened(tmp_path)
    track = recording.track()
    order = np.argsort(track.timestamp_ns)
    np.testing.assert_array_equal(track.timestamp_ns[order], ONE.stamps)
    np.testing.assert_allclose(np.asarray(track.latitude_deg)[order], ONE.truth().latitude_deg, atol=1e-11)
    assert dict(recording.images()["front_wide"].read(range(8))) == dict(enumerate(ONE.images))


def test_a_folder_of_consecutive_files_is_one_drive(tmp_path: Path) -> None:
    every = messages(ONE)
    for number, part in enumerate((every[:150], every[150:])):
        write_mcap(tmp_path / f"log_{number + 9}.mcap", part)
    (tmp_path / "topics.toml").write_text(TOPICS)
    recording = open_recording(tmp_path)
    assert isinstance(recording, LogRecording)
    require_drive(recording, ONE)
    assert [name for name, _ in recording.files()] == ["log_10.mcap", "log_9.mcap", "topics.toml"]


def test_chunks_without_a_requested_topic_are_not_read(tmp_path: Path) -> None:
    every = messages(ONE)
    every.sort(key=lambda message: (message.topic != "/tf_static", message.topic))
    log = McapFile(write_mcap(tmp_path / "log.mcap", every, chunk_bytes=2048))
    everything = sum(1 for _ in log.messages(log.topics()))
    read_all = log.chunks_read
    log.chunks_read = 0
    images = list(log.messages(["/front/image/compressed"]))
    assert everything == len(every) and len(images) == len(ONE.images)
    assert 0 < log.chunks_read < read_all / 3
    log.chunks_read = 0
    assert list(log.read([message.place for message in images])) == [message.data for message in images]
    assert log.chunks_read <= len({message.place.block for message in images})


def test_topics_come_from_the_summary_without_reading_chunks(tmp_path: Path) -> None:
    log = McapFile(write_mcap(tmp_path / "log.mcap", messages(ONE)))
    assert set(log.topics()) == {"/fix", "/imu", "/tf_static", "/front/image/compressed", "/front/camera_info"}
    assert log.chunks_read == 0
    bare = McapFile(write_mcap(tmp_path / "bare.mcap", messages(ONE), indexed=False))
    assert bare.topics() == log.topics()


def test_the_recording_is_not_written_to(tmp_path: Path) -> None:
    write_rosbag2(tmp_path / "log.db3", messages(ONE), definitions=True)
    (tmp_path / "log.toml").write_text(TOPICS)
    before = sorted(file.name for file in tmp_path.iterdir())
    (tmp_path / "log.db3").chmod(0o444)
    recording = open_recording(tmp_path / "log.db3")
    recording.track()
    dict(recording.images()["front_wide"].read([0, 3]))
    assert sorted(file.name for file in tmp_path.iterdir()) == before
    shutil.rmtree(tmp_path)
