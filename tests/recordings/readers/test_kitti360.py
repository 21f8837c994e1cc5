"""KITTI-360: drives written from a synthetic street are read back to their exact poses, cameras and stamps."""

from __future__ import annotations

import math
import os
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pyarrow.compute as pc
import pyproj
import pytest

from mirror.errors import RecordingError
from mirror.geometry.cameras import camera_from_row
from mirror.geometry.poses import COLUMNS, Poses
from mirror.geometry.quaternions import quaternion_exp
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.compare import Tolerances, angle_between, compare_boxes, compare_cameras, compare_poses
from tests.recordings.formats.kitti360 import CAMERAS, FISHEYES, MEI, SEMANTIC_IDS, write_kitti360
from tests.recordings.formats.street import StreetDrive, StreetObject, synth_drives

ROAD_USERS = ("car", "truck", "bus", "bicycle", "motorcycle")
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


def with_boxes_at_frames(drive: StreetDrive) -> StreetDrive:
    """The drive with the boxes that lie at frames."""
    at = np.isin(drive.box_ns, drive.image_ns["front_wide"])
    assert at.sum() > 20
    objects = tuple(replace(one, world_SE3_box=one.world_SE3_box[at]) for one in drive.objects)
    return replace(drive, box_ns=drive.box_ns[at], objects=objects)


def parked_car(drive: StreetDrive) -> StreetObject:
    """A car that is turned and tilted, beside the middle of the drive."""
    middle = drive.poses_at(drive.image_ns["front_wide"][26:27])
    pose = middle @ Poses(quaternion_exp([[0.02, -0.03, 1.1]]), np.array([[4.0, 3.0, 0.7]]))
    return StreetObject("parked", "car", (4.5, 1.9, 1.6), pose)


def test_boxes_of_frames_and_of_windows(drives: tuple[StreetDrive, ...], tmp_path: Path) -> None:
    drive = with_boxes_at_frames(drives[0])
    parked = parked_car(drive)
    pole = replace(parked, track_id="pole", category="pole")
    root = write_kitti360(tmp_path / "KITTI-360", [drive], parked=[parked, pole], boxes=True)
    recording = open_recording(root)
    assert f"data_3d_bboxes/train/{drive.name}.xml" in dict(recording.files())
    boxes = recording.boxes()
    assert boxes is not None
    moving = SimpleNamespace(boxes=lambda: boxes.filter(pc.field("track_id") != "13_100"))
    of_road_users = replace(drive, objects=tuple(one for one in drive.objects if one.category in ROAD_USERS))
    names = {one.track_id: f"{SEMANTIC_IDS.get(one.category)}_{number}" for number, one in enumerate(drive.objects)}
    velocities = compare_boxes(moving, of_road_users, names.__getitem__, Tolerances(position_m=1e-5, angle_rad=1e-7))
    assert all(np.isnan(speed).all() for speed in velocities.values())
    static = [row for row in boxes.to_pylist() if row["track_id"] == "13_100"]
    stamps = drive.image_ns["front_wide"]
    ego = drive.poses_at(stamps)
    near = np.linalg.norm(ego.translation - parked.world_SE3_box.translation, axis=1) <= 80.0
    assert [row["timestamp_ns"] for row in static] == stamps[near].tolist()
    world = ego[near] @ Poses.from_columns({name: [row[name] for row in static] for name in COLUMNS})
    assert np.abs(world.translation - parked.world_SE3_box.translation).max() < 1e-5
    assert angle_between(world.rotation, np.tile(parked.world_SE3_box.rotation, (len(world), 1))).max() < 1e-7
    assert {row["vx_mps"] for row in static} == {0.0}
    assert np.abs(np.array([row["length_m"] for row in static]) - 4.5).max() < 1e-9
    everything = open_recording(root, options={"boxes": "all"}).boxes()
    assert everything is not None and {"pole"} <= set(everything.column("category").to_pylist())
    assert open_recording(root, options={"boxes": "no"}).boxes() is None


def test_broken_boxes_are_named(drives: tuple[StreetDrive, ...], tmp_path: Path) -> None:
    drive = with_boxes_at_frames(drives[0])
    root = write_kitti360(tmp_path / "KITTI-360", [drive], boxes=True)
    file = root / "data_3d_bboxes" / "train" / f"{drive.name}.xml"
    text = file.read_text()
    numbers = text[text.index("<data>") : text.index("</data>")]
    for old, new, problem in (
        ("<instanceId>0<", "<instanceId><", "no instanceId"),
        ("<timestamp>0<", "<timestamp>first<", "invalid literal"),
        (numbers, "<data>1 2", "cannot reshape"),
        (numbers, "<data>" + "0 " * 16, "shears, or is flat"),
        (numbers, "<data>1 1 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "shears"),
        (numbers, "<data>nan", "no metres"),
    ):
        file.write_text(text.replace(old, new, 1))
        with pytest.raises(RecordingError, match=problem) as caught:
            open_recording(root).boxes()
        assert caught.value.file == str(file) and caught.value.place == "element object1"
    file.write_text(text[: len(text) // 2])
    with pytest.raises(RecordingError, match="cannot be read") as caught:
        open_recording(root).boxes()
    assert caught.value.file == str(file)


def test_fisheyes_become_the_nearest_lens_within_the_stated_distance(tmp_path: Path) -> None:
    """The reference is OpenCV's own model of Mei, whose first pixel's centre is at 0."""
    names = (*CAMERAS, *FISHEYES)
    drive = synth_drives()[0].placed(OFFSET_M).with_cameras(names)
    stamps = drive.image_ns["front_wide"][:4]
    raster = {name: replace(drive.cameras[name], width_px=1400, height_px=1400) for name in FISHEYES}
    drive = replace(drive, image_ns=dict.fromkeys(names, stamps), pose_ns=stamps, cameras={**drive.cameras, **raster})
    root = write_kitti360(tmp_path / "KITTI-360", [drive])
    recording = open_recording(root)
    assert recording.rig is not None and recording.rig.rig_id == "kitti360_image_00_image_01_image_02_image_03"
    rows = {row["camera"]: row for row in recording.calibrations().to_pylist()}
    angle, turn = np.meshgrid(np.radians(np.linspace(0.5, 97.0, 90)), np.linspace(0.0, 2.0 * np.pi, 40))
    directions = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=-1)
    directions = directions.reshape(-1, 3)
    for name, source in FISHEYES.items():
        row, mei = rows[source], MEI[source]
        matrix = np.array([[mei["gamma1"], 0.0, mei["u0"]], [0.0, mei["gamma2"], mei["v0"]], [0.0, 0.0, 1.0]])
        distortion = np.array([[mei[key] for key in ("k1", "k2", "p1", "p2")]])
        zero = np.zeros((3, 1))
        pixels, _ = cv2.omnidir.projectPoints(directions[:, None], zero, zero, matrix, mei["xi"], distortion)
        expected = pixels[:, 0] + 0.5
        inside = ((expected >= 0.0) & (expected < 1400.0)).all(axis=1)
        distance = np.linalg.norm(camera_from_row(row).project(directions).uv_px - expected, axis=1)[inside]
        stated = float(row["method"].split("within ")[1].split(" px")[0])
        assert inside.sum() > 3000 and 0.3 < stated < 0.9
        assert distance.max() < 1.05 * stated
        assert np.sqrt((distance**2).mean()) < 0.35
        mounting = Poses.from_columns({column: [row[column]] for column in COLUMNS})
        twist = (drive.ego_SE3_camera[name].inverse() @ mounting).log()
        assert np.abs(twist).max() < 1e-9
        for index, data in recording.images()[source].read([0, 3]):
            assert data == drive.image(name, index, ".png")
    alone = open_recording(root, options={"fisheye": "no"})
    assert list(alone.images()) == ["image_00", "image_01"] and alone.calibrations().num_rows == 2


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
