"""KITTI-360: drives written from a synthetic street are read back to their exact poses, cameras and stamps."""

from __future__ import annotations

import math
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.compare import Tolerances, compare_cameras, compare_poses
from tests.recordings.formats.kitti360 import CAMERAS, write_kitti360
from tests.recordings.formats.street import StreetDrive, synth_drives

OFFSET_M = (1107.0, 3826.0, 115.0)
NAMES = {"image_00": "front_wide", "image_01": "front_narrow"}
LAKE = (8.4295857, 48.9843445)


def _world() -> pyproj.Proj:
    """Mercator on the sphere, scaled at the lake's latitude: PROJ's own, as the reference."""
    return pyproj.Proj(f"+proj=merc +R=6378137 +k_0={math.cos(math.radians(LAKE[1]))!r}")


@pytest.fixture(scope="module")
def drives() -> tuple[StreetDrive, ...]:
    chosen = [drive.placed(OFFSET_M).with_cameras(tuple(CAMERAS)) for drive in synth_drives()]
    return tuple(
        replace(
            drive,
            image_ns=dict.fromkeys(CAMERAS, drive.image_ns["front_wide"]),
            pose_ns=drive.image_ns["front_wide"],
            cameras=chosen[0].cameras,
            ego_SE3_camera=chosen[0].ego_SE3_camera,
        )
        for drive in chosen
    )


@pytest.fixture(scope="module")
def pristine(drives: tuple[StreetDrive, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_kitti360(tmp_path_factory.mktemp("kitti") / "KITTI-360", drives)


@pytest.fixture
def folder(pristine: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(pristine, tmp_path / "KITTI-360"))


def test_drives_are_read_back_exactly(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    found = find_recordings([pristine])
    assert [path.name for path in found.recordings] == [drive.name for drive in drives]
    for path, drive in zip(found.recordings, drives):
        recording = open_recording(path)
        assert recording.info.drive_id == f"kitti360_{drive.name}" and recording.info.body_frame == "imu"
        track = recording.track()
        assert track.longitude_deg is not None and track.rotation is not None
        world = _world()
        x, y = world(track.longitude_deg, track.latitude_deg)
        origin = world(*LAKE)
        poses = Poses(track.rotation, np.stack([x - origin[0], y - origin[1], track.height_m], axis=1))
        compare_poses(track.timestamp_ns, poses, drive, Tolerances(position_m=1e-5))
        compare_cameras(recording, drive, NAMES, Tolerances())
        assert recording.boxes() is None


def test_ingest_finds_the_traversals_of_both_drives(pristine: Path, tmp_path: Path) -> None:
    world = _world()
    east, north = world(*LAKE)
    lon, lat = world(east + OFFSET_M[0], north + OFFSET_M[1], inverse=True)
    scene = Roi(scene_id="place", longitude_deg=lon, latitude_deg=lat, radius_m=100.0)
    paths = find_recordings([pristine]).recordings
    report = ingest_recordings(paths, [scene], tmp_path / "d", IngestOptions(workers=1))
    assert not report.failures
    assert [one.images for one in report.traversals] == [2 * 52, 2 * 52]


def test_a_zone_moves_all_stamps(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    recording = open_recording(pristine / drives[0].name, options={"tz": "Etc/GMT-2"})
    hours = (drives[0].pose_ns - recording.track().timestamp_ns) / 3.6e12
    assert set(hours.tolist()) == {2.0}
    assert (recording.images()["image_00"].exposure_start_ns == recording.track().timestamp_ns).all()
    with pytest.raises(RecordingError, match="unknown time zone"):
        open_recording(pristine / drives[0].name, options={"tz": "Mars"}).track()


def test_fisheye_cameras_are_refused_by_name(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    with pytest.raises(RecordingError, match="image_02 and image_03 have the model of Mei"):
        open_recording(pristine / drives[0].name, options={"fisheye": "yes"})


def test_faults_are_named(folder: Path, drives: tuple[StreetDrive, ...]) -> None:
    name = drives[0].name
    poses = folder / "data_poses" / name / "poses.txt"
    lines = poses.read_text().splitlines()
    lines[3] = " ".join(lines[3].split()[:7])
    lines[5] = lines[5].replace(lines[5].split()[1], "nan")
    lines[7] = "9999 " + lines[7].partition(" ")[2]
    poses.write_text("\n".join(lines) + "\n")
    track = open_recording(folder / name).track()
    assert track.bad is not None and track.bad.counts() == {"cells": 1, "time": 1, "rotation": 1}
    assert track.bad.first.place == "line 4"
    turned = []
    for words in map(str.split, lines[10:]):
        matrix = [str(-float(word)) if column % 4 in (1, 2) else word for column, word in enumerate(words[1:])]
        turned.append(" ".join([words[0], *matrix]))
    poses.write_text("\n".join(turned) + "\n")
    with pytest.raises(RecordingError, match="stands on its head"):
        open_recording(folder / name).track()
    calibration = folder / "calibration" / "perspective.txt"
    calibration.write_text(calibration.read_text().replace("P_rect_01", "P_rect_09"))
    with pytest.raises(RecordingError, match="the line is missing") as caught:
        open_recording(folder / name).calibrations()
    assert caught.value.place == "P_rect_01" and caught.value.file == str(calibration)
    stamps = folder / "data_2d_raw" / name / "image_01" / "timestamps.txt"
    stamps.write_text("\n".join(stamps.read_text().splitlines()[:9]) + "\n")
    with pytest.raises(RecordingError, match="the frame has no stamp") as caught:
        open_recording(folder / name).images()
    assert caught.value.file is not None and caught.value.file.endswith("0000000009.png")
    stamps.unlink()
    with pytest.raises(RecordingError, match="missing") as caught:
        open_recording(folder / name).images()
    assert "data_timestamps_perspective.zip" in str(caught.value.remedy)
    poses.unlink()
    os.mkfifo(poses)
    with pytest.raises(RecordingError, match="no plain file"):
        open_recording(folder / name)
