"""nuScenes -> MIRROR -> nuScenes and COLMAP -> MIRROR -> COLMAP: what was there comes back, within stated tolerances.

World frames differ by the region's place, so that poses are compared relative to the first image of a drive, and boxes
relative to the camera that sees them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mirror
from mirror.dataset.times import solar_date
from mirror.export.run import ExportOptions, export
from mirror.geometry.poses import Poses
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.builders.street import LENSES, make_street
from tests.recordings.formats.nuscenes import CHANNELS, write_nuscenes
from tests.recordings.formats.street import synth_drives

OFFSET_M = (1620.0, 1180.0, 0.0)
CAMERAS = ("front_wide", "front_left", "rear")
Tables = dict[str, dict[str, dict[str, Any]]]
SeenBox = tuple[str, Poses, list[float], str, list[str]]


def pose_of(row: dict[str, Any]) -> Poses:
    return Poses(np.array([row["rotation"]]), np.array([row["translation"]]))


def tables_of(folder: Path) -> Tables:
    return {path.stem: {row["token"]: row for row in json.loads(path.read_text())} for path in folder.glob("*.json")}


def camera_images(tables: Tables) -> dict[tuple[str, str, int], dict[str, Any]]:
    """Rows of ``sample_data`` of cameras, by drive, channel and time in microseconds."""
    rows = {}
    for row in tables["sample_data"].values():
        calibrated = tables["calibrated_sensor"][row["calibrated_sensor_token"]]
        sensor = tables["sensor"][calibrated["sensor_token"]]
        if sensor["modality"] == "camera":
            scene = tables["scene"][tables["sample"][row["sample_token"]]["scene_token"]]
            log = tables["log"][scene["log_token"]]["logfile"]
            name = scene["name"].split(".")[1] if scene["name"].count(".") == 2 else scene["name"]
            rows[name, sensor["channel"], row["timestamp"]] = {**row, "calibrated": calibrated, "log": log}
    return rows


def largest_relative(source: list[Poses], found: list[Poses]) -> tuple[float, float]:
    """Largest rotation (rad) and translation (m) between motions since the first pose."""
    twists = []
    for a, b in zip(source, found):
        twists.append(((source[0].inverse() @ a).inverse() @ (found[0].inverse() @ b)).log()[0])
    norms = np.array([[np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])] for twist in twists])
    rotation, translation = norms.max(axis=0)
    return float(rotation), float(translation)


@pytest.fixture(scope="module")
def nuscenes(tmp_path_factory: pytest.TempPathFactory) -> tuple[Tables, Tables]:
    """The tables of a nuScenes folder, and those of its export from a dataset."""
    root = tmp_path_factory.mktemp("nuscenes")
    drives = [drive.placed(OFFSET_M).with_cameras(tuple(CHANNELS)) for drive in synth_drives()]
    source = write_nuscenes(root / "source", drives, location="a-place")
    paths = find_recordings([source]).recordings
    frame = open_recording(paths[0]).info.frame
    scene = Roi(scene_id="place", frame=frame, x_m=OFFSET_M[0], y_m=OFFSET_M[1], radius_m=100.0)
    assert not ingest_recordings(paths, [scene], root / "dataset", IngestOptions(workers=1)).failures
    written = export(mirror.open(root / "dataset"), "nuscenes", root / "out")
    assert written.boxes > 0
    return tables_of(source / "v1.0-mini"), tables_of(root / "out" / "v1.0-mirror")


def test_nuscenes_images_poses_and_cameras_come_back(nuscenes: tuple[Tables, Tables]) -> None:
    source, found = map(camera_images, nuscenes)
    common = sorted(set(source) & set(found))
    assert len(common) == len(found)
    assert len(found) > 0.8 * len(source)
    for drive in {key[0] for key in common}:
        for channel in CHANNELS.values():
            keys = [key for key in common if key[:2] == (drive, channel)]
            poses = [
                [pose_of(tables["ego_pose"][rows[key]["ego_pose_token"]]) for key in keys]
                for tables, rows in zip(nuscenes, (source, found))
            ]
            rotation, translation = largest_relative(*poses)
            assert translation < 1e-6
            assert rotation < 1e-7
    for key in common:
        for name in ("translation", "rotation", "camera_intrinsic"):
            np.testing.assert_allclose(found[key]["calibrated"][name], source[key]["calibrated"][name], atol=1e-8)
        assert [found[key][name] for name in ("width", "height")] == [source[key][name] for name in ("width", "height")]


def boxes_in_cameras(tables: Tables) -> dict[tuple[str, str, int], list[SeenBox]]:
    """Of each keyframe image: instance, pose in the camera, size, category and attributes of the boxes."""
    by_sample: dict[str, list[dict[str, Any]]] = {}
    for row in tables["sample_annotation"].values():
        by_sample.setdefault(row["sample_token"], []).append(row)
    found = {}
    for key, row in camera_images(tables).items():
        if row["is_key_frame"]:
            world_SE3_camera = pose_of(tables["ego_pose"][row["ego_pose_token"]]) @ pose_of(row["calibrated"])
            found[key] = [
                (
                    box["instance_token"],
                    world_SE3_camera.inverse() @ pose_of(box),
                    box["size"],
                    tables["category"][tables["instance"][box["instance_token"]]["category_token"]]["name"],
                    [tables["attribute"][token]["name"] for token in box["attribute_tokens"]],
                )
                for box in by_sample.get(row["sample_token"], [])
            ]
    return found


def test_nuscenes_boxes_and_tracks_come_back(nuscenes: tuple[Tables, Tables]) -> None:
    source, found = map(boxes_in_cameras, nuscenes)
    same: dict[str, str] = {}
    stated: set[str] = set()
    compared = 0
    for key in sorted(set(source) & set(found)):
        assert len(found[key]) == len(source[key]), key
        for instance, pose, size, category, attributes in source[key]:
            distances = [np.linalg.norm(other[1].translation - pose.translation) for other in found[key]]
            other = found[key][int(np.argmin(distances))]
            twist = (other[1].inverse() @ pose).log()[0]
            assert np.linalg.norm(twist[3:]) < 1e-5
            assert np.linalg.norm(twist[:3]) < 1e-6
            np.testing.assert_allclose(other[2], size, atol=1e-9)
            assert other[3] == category and other[4] == attributes
            stated.update(attributes)
            assert same.setdefault(instance, other[0]) == other[0]
            compared += 1
    assert compared > 100 and stated == {"vehicle.moving", "vehicle.parked"}
    assert len(set(same.values())) == len(same)


def test_nuscenes_keyframes_stay_keyframes(nuscenes: tuple[Tables, Tables]) -> None:
    source, found = map(camera_images, nuscenes)
    boxes = boxes_in_cameras(nuscenes[0])
    kept = 0
    for key in set(source) & set(found):
        sample = nuscenes[0]["sample"][source[key]["sample_token"]]
        # The last sample of the source lies after its last image: its boxes belong to no frame.
        if source[key]["is_key_frame"] and boxes[key] and abs(sample["timestamp"] - key[2]) < 100_000:
            assert found[key]["is_key_frame"]
            kept += 1
        if not source[key]["is_key_frame"]:
            assert not found[key]["is_key_frame"]
    assert kept > 300


def test_colmap_comes_back(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    from tests.recordings.formats.colmap import write_colmap

    drives = [drive.with_cameras(CAMERAS) for drive in synth_drives()]
    source = write_colmap(tmp_path / "source", drives)
    paths = find_recordings([source]).recordings
    frame = open_recording(paths[0]).info.frame
    scene = Roi(scene_id="place", frame=frame, x_m=0.0, y_m=0.0, radius_m=100.0)
    assert not ingest_recordings(paths, [scene], tmp_path / "dataset", IngestOptions(workers=1)).failures
    dataset = mirror.open(tmp_path / "dataset")
    export(dataset, "colmap", tmp_path / "out")
    before, after = (pycolmap.Reconstruction(str(path / "sparse" / "0")) for path in (source, tmp_path / "out"))
    by_name = {image.name: image for image in before.images.values()}
    groups: dict[tuple[str, str], list[tuple[Any, Any]]] = {}
    for image in after.images.values():
        traversal, camera, file = image.name.split("/")
        original = by_name[f"{traversal.split('.')[1]}/{camera}/{file}"]
        groups.setdefault((traversal, camera), []).append((original, image))
        old, new = original.camera, image.camera
        assert (old.width, old.height) == (new.width, new.height)
        np.testing.assert_allclose(new.calibration_matrix(), old.calibration_matrix(), atol=1e-9)
        old_path, new_path = source / "images" / original.name, tmp_path / "out" / "images" / image.name
        assert old_path.read_bytes() == new_path.read_bytes()
    assert len(groups) == len(drives) * len(CAMERAS)
    for pairs in groups.values():
        pairs.sort(key=lambda pair: pair[1].name)
        poses = [
            [Poses.from_matrix(np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])).inverse() for image in side]
            for side in zip(*pairs)
        ]
        rotation, translation = largest_relative(*poses)
        assert translation < 1e-6
        assert rotation < 1e-7


def test_a_dataset_comes_back_from_colmap_with_its_lenses_and_stamps(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    cameras = tuple(name for name, lens in LENSES.items() if lens.model != "f_theta")
    street = make_street(tmp_path / "dataset", cameras)
    export(street, "colmap", tmp_path / "out")
    found = find_recordings([tmp_path / "out"]).recordings
    assert len(found) == 2
    for path, traversal in zip(found, street.traversals()):
        recording = open_recording(path)
        streams = recording.images()
        frames = list(street.where(traversal=traversal).frames())
        lenses = {row["camera"]: row for row in recording.calibrations().to_pylist()}
        for camera in cameras:
            stamps = [frame.images[camera].timestamp_ns for frame in frames]
            assert streams[camera].exposure_start_ns.tolist() == stamps
            lens = LENSES[camera]
            row = lenses[camera]
            expected = [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px]
            np.testing.assert_allclose([row["fx_px"], row["fy_px"], row["cx_px"], row["cy_px"]], expected, rtol=1e-15)
            ours = np.zeros(8)
            ours[: len(lens.distortion)] = lens.distortion
            theirs = np.zeros(8)
            theirs[: len(row["distortion"])] = row["distortion"]
            np.testing.assert_array_equal(theirs, ours)


@pytest.mark.parametrize(
    ("entry_ns", "longitude_deg", "date"),
    [
        # n015-2018-07-24-11-22-45+0800 of nuScenes: the morning in Singapore.
        (1532402565_000000000, 103.8, "2018-07-24"),
        (1532386800_000000000, 103.8, "2018-07-24"),
        (1532386800_000000000, -71.1, "2018-07-23"),
        (1532386800_000000000, None, "2018-07-23"),
    ],
)
def test_the_date_of_a_log_is_that_of_the_place(entry_ns: int, longitude_deg: float | None, date: str) -> None:
    """1532386800 is 23:00 UTC of 23 July: 07:00 of the next day in Singapore, 19:00 in Boston."""
    assert solar_date(entry_ns, longitude_deg) == date


def test_nuscenes_states_the_date_of_the_place(tmp_path: Path) -> None:
    # 22:13 UTC is the morning of the next day there.
    street = make_street(tmp_path / "street", longitude_deg=103.8)
    export(street, "nuscenes", tmp_path / "out", ExportOptions(undistort=True))
    rows = {row["drive_id"]: row for row in street.table("traversals").to_pylist()}
    logs = json.loads((tmp_path / "out" / "v1.0-mirror" / "log.json").read_text())
    assert len(logs) == 2
    for log in logs:
        row = rows[log["logfile"]]
        # Stated here by hand: four minutes of time a degree, east first.
        local = row["entry_ns"] / 1e9 + 240.0 * row["bbox"]["xmin"]
        assert row["bbox"]["xmin"] == pytest.approx(103.8, abs=0.01)
        assert log["date_captured"] == str(np.datetime64(int(local), "s").astype("datetime64[D]"))
