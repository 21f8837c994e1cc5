"""Fixes in videos, in GPMF and CAMM: written by this project and read back; PyAV finds the same samples."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode, RecordingError
from mirror.recordings.discovery import find_recordings
from mirror.recordings.protocol import Track
from mirror.recordings.readers.mp4_metadata import read_metadata_track
from mirror.recordings.registry import load_readers, open_recording
from tests.recordings.formats.video_gps import Fixes, camm5, camm6, gps5, gps9, with_track, write_video

FIXES = Fixes(lost=(0, 7))
KINDS: dict[str, tuple[str, Callable[[Fixes], list[bytes]], int]] = {
    "gps5": ("gpmd", gps5, 1000),
    "gps9": ("gpmd", gps9, 1000),
    "camm6": ("camm", camm6, 31),
    "camm5": ("camm", camm5, 62),
}


def video(folder: Path, kind: str, **others: object) -> Path:
    name, make, step = KINDS[kind]
    return write_video(folder / f"{kind}.mp4", name, make(FIXES), step, **others)  # type: ignore[arg-type]


def degrees(track: Track) -> np.ndarray:
    return np.column_stack([track.longitude_deg, track.latitude_deg, track.height_m])


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_fixes_are_read_back(kind: str, wide: bool, tmp_path: Path) -> None:
    file = video(tmp_path, kind, wide=wide, created_ns=FIXES.start_ns)
    recording = open_recording(file, options={"drive_id": "monday"})
    assert find_recordings([tmp_path]).recordings == (file,)
    track = recording.track()
    assert recording.info.drive_id == "monday" and recording.rig is None and track.rotation is None
    np.testing.assert_allclose(degrees(track), FIXES.degrees, atol=1e-9)
    assert np.isnan(track.longitude_deg).sum() == 32  # type: ignore[arg-type]
    if kind == "camm5":
        # At the time of creation, of whole seconds, and the samples' own of whole milliseconds.
        start = FIXES.start_ns // 10**9 * 10**9
        assert (track.timestamp_ns - start).tolist() == [62_000_000 * row for row in range(len(track))]
        assert "have no time" in recording.info.notes[1]
    else:
        # Milliseconds of GPS9, float64 of CAMM, whole sixteenths of GPS5.
        assert np.abs(track.timestamp_ns - FIXES.stamps).max() <= {"gps5": 0, "gps9": 500_000, "camm6": 300}[kind]
        begins = recording.info.notes[1].partition("--start CAMERA=")[2]
        seconds = (np.datetime64(begins.removesuffix("Z"), "ns").astype(int) - FIXES.start_ns) * 1e-9
        assert abs(seconds) < (0.05 if kind == "camm6" else 1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_pyav_finds_the_same_samples(kind: str, tmp_path: Path) -> None:
    file = video(tmp_path, kind)
    ours = read_metadata_track(file, ("gpmd", "camm"))
    with av.open(str(file)) as container:
        stream = container.streams[1]
        theirs = [(packet.pts * stream.time_base, bytes(packet)) for packet in container.demux(stream) if packet.size]
    assert [data for _, data in theirs] == ours.samples
    assert [round(pts * 10**9) for pts, _ in theirs] == ours.start_ns.tolist()


def test_cameras_that_write_unix_time_are_named(tmp_path: Path) -> None:
    file = write_video(tmp_path / "a.mp4", "camm", camm6(FIXES, unix=True), 31, created_ns=FIXES.start_ns + 10**9)
    with pytest.raises(RecordingError, match="the fixes begin at 2036") as caught:
        open_recording(file)
    assert "--option clock=unix" in str(caught.value.remedy)
    track = open_recording(file, options={"clock": "unix"}).track()
    assert np.abs(track.timestamp_ns - FIXES.stamps).max() < 300
    with pytest.raises(RecordingError, match="clock is an option for CAMM"):
        open_recording(video(tmp_path, "gps5"), options={"clock": "unix"})
    with pytest.raises(RecordingError, match="clock='moon'"):
        open_recording(file, options={"clock": "moon"})


@pytest.mark.parametrize("kind", ["gps5", "gps9", "camm6"])
def test_damaged_payloads_cost_their_fixes(kind: str, tmp_path: Path) -> None:
    name, make, step = KINDS[kind]
    samples = make(Fixes())
    samples[3] = samples[3][:-20]
    samples[5] = b"\0\0\x20\0" if kind == "camm6" else samples[5].replace(b"SCAL", b"SCAR")
    track = open_recording(write_video(tmp_path / "a.mp4", name, samples, step)).track()
    # The samples of CAMM with odd numbers are fixes, those of GPMF hold 16.
    lost = [1, 2] if kind == "camm6" else [*range(48, 64), *range(80, 96)]
    kept = np.delete(np.arange(192), lost)
    assert np.abs(track.timestamp_ns - Fixes().stamps[kept]).max() <= 500_000
    np.testing.assert_allclose(degrees(track), Fixes().degrees[kept], atol=1e-9)
    assert track.bad is not None and track.bad.counts() == {"cells": 2}
    assert track.bad.first.file == str(tmp_path / "a.mp4")
    assert track.bad.first.place == ("sample 3" if kind == "camm6" else "payload 3")


@pytest.mark.parametrize(
    ("name", "samples", "problem"),
    [
        ("gpmd", gps5(Fixes(lost=tuple(range(12)))), "no fix with a time"),
        ("gpmd", [b""] * 3 + [b"\0" * 8], "no fixes"),
        ("camm", [struct.pack("<HH3f", 0, 2, 0.0, 0.0, 0.0)], "no fixes"),
        ("camm", camm5(Fixes()), "no date"),
        ("tmcd", [b"tick"], "no track of the format gpmd or camm"),
    ],
)
def test_videos_without_fixes_are_refused(name: str, samples: list[bytes], problem: str, tmp_path: Path) -> None:
    file = write_video(tmp_path / "a.mp4", name, samples, 1000)
    with pytest.raises(RecordingError, match=problem) as caught:
        open_recording(file, "video_gps")
    assert caught.value.file == str(file) and caught.value.remedy and caught.value.expected


def test_broken_files_are_refused_by_name(tmp_path: Path) -> None:
    """With each byte of the index replaced, the file is refused by name or read."""
    whole = write_video(tmp_path / "whole.mp4", "gpmd", gps5(Fixes(seconds=2)), 1000).read_bytes()
    index = whole.index(b"moov") - 4
    file = tmp_path / "a.mp4"
    refused = 0
    reader = load_readers("video_gps")["video_gps"]
    for position in range(index, len(whole)):
        file.write_bytes(whole[:position] + bytes([(0, 1, 0xFF)[position % 3]]) + whole[position + 1 :])
        try:
            reader.open(file, {}).track()
        except RecordingError as error:
            assert error.file == str(file) and error.remedy
            refused += 1
    assert refused > 100
    for end in range(0, len(whole), 13):
        file.write_bytes(whole[:end])
        with pytest.raises(RecordingError):
            reader.open(file, {})
    nested = b"moov"
    for _ in range(5000):
        nested = struct.pack(">I", 4 + len(nested)) + nested
        nested = b"mdia" + nested
    file.write_bytes(struct.pack(">I", 4 + len(nested)) + b"moov" + nested[4:])
    with pytest.raises(RecordingError):
        open_recording(file, "video_gps")


def test_a_video_and_its_own_fixes_become_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = tmp_path / "plain.mp4"
    with av.open(str(plain), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"g": "5"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(120):
            image = cv2.resize(np.random.default_rng(number).integers(0, 255, (6, 8, 3), np.uint8), (64, 48))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "rgb24")))
        container.mux(stream.encode())
    file = with_track(plain, tmp_path / "drive.mp4", "gpmd", gps9(Fixes()), 1000)
    start = open_recording(file).info.notes[1].partition("--start CAMERA=")[2]
    out = tmp_path / "monday"
    words = ["--camera", f"front_wide={file}", "--start", f"front_wide={start}", "--out", str(out), "--json"]
    assert main(["recording", "new", "--poses", str(file), *words]) == ExitCode.DONE
    said = json.loads(capsys.readouterr().out)
    assert said["poses"] == 192 and said["images"] == {"front_wide": 120}
    made = open_recording(out)
    np.testing.assert_allclose(degrees(made.track()), Fixes().degrees, atol=1e-8)
    assert made.images()["front_wide"].exposure_start_ns[0] == Fixes().start_ns
    # A video without fixes is no recording.
    assert find_recordings([tmp_path]).recordings == (file, out)
    assert main(["recording", "new", "--poses", str(plain), *words]) == ExitCode.COULD_NOT_RUN
