"""One drive in every container and encoding: the same poses, calibrations and images, equal to the truth."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType

from mirror.geometry.geodesy import geodetic_to_ecef
from mirror.recordings.protocol import Track
from mirror.recordings.readers.message_logs.mcap_file import McapFile
from mirror.recordings.readers.message_logs.recording import LogRecording
from mirror.recordings.registry import open_recording
from tests.recordings.message_logs.writer import (
    EGO_SE3_CAMERA,
    LENS,
    TOPICS,
    Drive,
    drive,
    messages,
    write_mcap,
    write_rosbag2,
)

ONE = drive()
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


def opened(folder: Path, text: str = TOPICS) -> LogRecording:
    (folder / "log.toml").write_text(text)
    recording = open_recording(next(file for file in folder.iterdir() if file.suffix in (".mcap", ".db3")))
    assert isinstance(recording, LogRecording)
    return recording


def require_same_track(track: Track, truth: Track, metres: float = 1e-6) -> None:
    np.testing.assert_array_equal(track.timestamp_ns, truth.timestamp_ns)
    ours, theirs = (
        geodetic_to_ecef(np.asarray(one.longitude_deg), np.asarray(one.latitude_deg), np.asarray(one.height_m))
        for one in (track, truth)
    )
    assert np.abs(ours - theirs).max() < metres
    same = np.abs(np.einsum("ij,ij->i", np.asarray(track.rotation), np.asarray(truth.rotation)))
    np.testing.assert_allclose(same, 1.0, atol=1e-12)


def require_drive(recording: LogRecording, one: Drive) -> None:
    track = recording.track()
    assert track.bad is None
    require_same_track(track, one.truth())
    np.testing.assert_allclose(np.asarray(track.sigma_m), 0.2, rtol=1e-12)
    (row,) = recording.calibrations().to_pylist()
    assert (row["model"], row["width_px"], row["fx_px"], row["fy_px"]) == ("brown_conrady", 64, 50.0, 51.0)
    # Pixel centres at whole numbers in the message, at halves in MIRROR.
    assert (row["cx_px"], row["cy_px"], tuple(row["distortion"])) == (32.0, 24.0, LENS)
    mounting = [row[name] for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")]
    expected = [*EGO_SE3_CAMERA.rotation[0], *EGO_SE3_CAMERA.translation[0]]
    np.testing.assert_allclose(mounting, expected, atol=1e-15)
    stream = recording.images()["front_wide"]
    np.testing.assert_array_equal(stream.exposure_start_ns, one.image_stamps)
    assert dict(stream.read(range(len(one.images)))) == dict(enumerate(one.images))
    assert dict(stream.read([1, 5])) == {1: one.images[1], 5: one.images[5]}


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
