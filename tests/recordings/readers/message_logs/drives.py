"""One drive, its log opened as a recording, and what the recording must hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mirror.geometry.geodesy import geodetic_to_ecef
from mirror.recordings.protocol import Track
from mirror.recordings.readers.message_logs.recording import LogRecording
from mirror.recordings.registry import open_recording
from tests.recordings.readers.message_logs.writer import EGO_SE3_CAMERA, LENS, TOPICS, Drive, drive

ONE = drive()


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
