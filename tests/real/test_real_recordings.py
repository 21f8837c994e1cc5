"""Recordings from outside this project, from recording to dataset; expected figures are counted by other means."""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyproj
import pytest

import mirror
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.poses import Poses
from mirror.ingest.propose import propose_rois
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.schema.documents import DriveDocument, Roi
from mirror.schema.files import read_json
from tests.builders.folder import tree

GEOD = pyproj.Geod(ellps="WGS84")
RSK = IngestOptions(
    reader_options={"tz": "Africa/Casablanca", "date_format": "MM/DD/YYYY"}, trigger={"max_gap_s": 30.0}
)


def boreas_visits(folder: Path, roi: Roi) -> list[tuple[float, float]]:
    """Times in seconds, at the resolution of the poses, between which a Boreas drive is within a ROI."""
    with (folder / "camera_poses.csv").open() as file:
        rows = [(float(row["GPSTime"]), float(row["easting"]), float(row["northing"])) for row in csv.DictReader(file)]
    stamps, east, north = np.array(rows).T
    lon, lat = pyproj.Transformer.from_crs(32617, 4326, always_xy=True).transform(east, north)
    ones = np.ones_like(lon)
    distance = GEOD.inv(lon, lat, roi.longitude_deg * ones, roi.latitude_deg * ones)[2]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], distance <= roi.radius_m, [0]])))
    return [(stamps[a] / 1e6, stamps[b - 1] / 1e6) for a, b in edges.reshape(-1, 2)]


def test_boreas_loops_agree_where_both_passed(real_data: Path, tmp_path: Path) -> None:
    loops = sorted((real_data / "boreas").glob("boreas-*"))
    proposals = propose_rois(loops, count=6)
    assert not proposals.failures
    assert len(proposals.ranked) == 6
    for one in proposals.ranked:
        assert one.drives == 2
        for other in proposals.ranked:
            if one is not other:
                a, b = one.roi, other.roi
                apart = GEOD.inv(a.longitude_deg, a.latitude_deg, b.longitude_deg, b.latitude_deg)[2]
                assert apart >= 400.0
    rois = [one.roi for one in proposals.ranked]
    options = IngestOptions(trigger={"trim_standstill_s": None, "join_gap_s": 0.0})
    report = ingest_recordings(loops, rois, tmp_path / "d", options)
    for drive_id, drive in report.drives.items():
        for roi in rois:
            expected = boreas_visits(real_data / "boreas" / drive_id, roi)
            found = sorted((one for one in drive.passes if one.scene_id == roi.scene_id), key=lambda one: one.entry_ns)
            assert len(found) == len(expected)
            for one, (entry_s, exit_s) in zip(found, expected):
                assert -1e-6 <= entry_s - one.entry_ns * 1e-9 <= 0.101
                assert -1e-6 <= one.exit_ns * 1e-9 - exit_s <= 0.101
                if not one.accepted:
                    assert one.duration_s < 10.0 or one.path_m < 20.0 or one.overlap <= 0.9
    dataset = mirror.open(tmp_path / "d")
    assert dataset.count("traversals") == len(report.traversals) >= 12
    assert dataset.table("traversals", ["has_images"]).column("has_images").to_pylist() == [False] * len(
        report.traversals
    )


def test_boreas_forward_axis_is_the_direction_of_travel(real_data: Path, tmp_path: Path) -> None:
    loop = sorted((real_data / "boreas").glob("boreas-*"))[0]
    proposals = propose_rois([loop], count=1)
    ingest_recordings([loop], [proposals.ranked[0].roi], tmp_path / "d")
    poses = mirror.open(tmp_path / "d").table("ego_poses")
    columns = {name: poses.column(name).to_numpy() for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")}
    world_SE3_ego = Poses.from_columns(columns)
    moved = np.diff(world_SE3_ego.translation, axis=0)
    seconds = np.diff(poses.column("timestamp_ns").to_numpy()) * 1e-9
    fast = (np.linalg.norm(moved, axis=1) > 3.0 * seconds) & (seconds < 0.2)
    assert fast.sum() > 50
    forward = world_SE3_ego.matrix()[:-1, :3, 0][fast]
    direction = moved[fast] / np.linalg.norm(moved[fast], axis=1)[:, None]
    assert np.median(np.degrees(np.arccos(np.clip((forward * direction).sum(axis=1), -1, 1)))) < 3.0
    assert (world_SE3_ego.matrix()[:, 2, 2] > 0.98).all()


def test_rsk_drives_are_cleaned_counted_and_pass_as_on_a_map(real_data: Path, tmp_path: Path) -> None:
    drives = sorted((real_data / "rsk_twizy_t3").glob("*.csv"))
    assert len(drives) == 10
    # A point on the one road between the two ends of the route, far from both.
    roi = Roi(scene_id="corniche", longitude_deg=-6.7756, latitude_deg=33.9891)
    report = ingest_recordings(drives, [roi], tmp_path / "d", RSK)
    assert not report.failures
    for path in drives:
        with path.open() as file:
            fixes = [(float(row["LON"]), float(row["LAT"])) for row in csv.DictReader(file)]
        drive = next(drive for drive in report.drives.values() if drive.path == path)
        assert drive.cleaning.poses == len(fixes)
        assert drive.cleaning.invalid == sum(abs(lon) > 180 or abs(lat) > 90 for lon, lat in fixes)
        same = sum(a == b for a, b in pairwise(fixes))
        assert same * 0.9 <= drive.cleaning.repeated <= same
        # Number of times that the route passes the point: changes of the nearer end of the route, on the fixes.
        good = [(lon, lat) for lon, lat in fixes if abs(lon) < 180]
        crossings = sum((a[0] < roi.longitude_deg) != (b[0] < roi.longitude_deg) for a, b in pairwise(good))
        assert len(drive.passes) == crossings, path.name
        assert all(one.accepted or one.rule == "min_duration" for one in drive.passes)
    assert sum(drive.cleaning.invalid for drive in report.drives.values()) > 0
    assert len(report.traversals) >= 10


def test_rsk_without_a_larger_gap_has_only_fragments(real_data: Path, tmp_path: Path) -> None:
    drives = sorted((real_data / "rsk_twizy_t3").glob("*.csv"))
    roi = Roi(scene_id="corniche", longitude_deg=-6.7756, latitude_deg=33.9891)
    options = IngestOptions(reader_options=RSK.reader_options)
    report = ingest_recordings(drives, [roi], tmp_path / "d", options)
    assert not report.traversals
    assert {one.exit_kind for drive in report.drives.values() for one in drive.passes} <= {"gap", "crossing"}


@pytest.fixture(scope="module")
def dgp(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> mirror.Dataset:
    scene = real_data / "dgp_scene_02"
    options = IngestOptions(trigger={"min_duration_s": 0.1, "min_path_m": 1.0})
    local = propose_rois([scene], count=1, options=options).ranked[0].roi
    out = tmp_path_factory.mktemp("dgp") / "d"
    report = ingest_recordings([scene], [local], out, options)
    assert not report.failures
    assert report.images == 18
    return mirror.open(out)


def test_dgp_keeps_its_own_frame(dgp: mirror.Dataset) -> None:
    scene = dgp.table("scenes").to_pylist()[0]
    assert scene["frame"].startswith("dgp_scene_02")
    assert scene["geometry"] is None
    poses = dgp.table("ego_poses", ["tx_m", "ty_m", "longitude_deg"])
    assert poses.column("longitude_deg").null_count == poses.num_rows
    assert abs(poses.column("ty_m").to_numpy() + 2262).max() < 4


def test_dgp_has_six_synchronised_cameras(dgp: mirror.Dataset) -> None:
    frames = dgp.frames()
    assert len(frames) == 3
    for frame in frames:
        assert len(frame.images) == 6
        stamps = [image.timestamp_ns for image in frame.images.values()]
        assert max(stamps) - min(stamps) < 50_000_000
        assert frame.decode().shape == (6, 3, 1216, 1936)


def test_dgp_boxes_project_onto_the_cars(dgp: mirror.Dataset, real_data: Path) -> None:
    """The source's own 2D boxes on the images are the reference of the projected 3D boxes."""
    overlaps = []
    for number, frame in enumerate(dgp.frames()):
        for camera, image in frame.images.items():
            boxes = frame.boxes(f"camera:{camera}")
            path = sorted((real_data / "dgp_scene_02" / "bounding_box_2d" / camera).glob("*.json"))[number]
            drawn = {str(one["instance_id"]): one["box"] for one in json.loads(path.read_text())["annotations"]}
            projected = project_boxes(image.camera_model, boxes.pose, boxes.size_m)
            for row, track in enumerate(boxes.track_id):
                box = drawn.get(track)
                if box is None:
                    continue
                assert projected.visible[row]
                left, top, right, bottom = projected.bounds_px[row]
                wide = min(right, box["x"] + box["w"]) - max(left, box["x"])
                high = min(bottom, box["y"] + box["h"]) - max(top, box["y"])
                shared = max(wide, 0.0) * max(high, 0.0)
                overlaps.append(shared / ((right - left) * (bottom - top) + box["w"] * box["h"] - shared))
    assert len(overlaps) == 39
    assert np.median(overlaps) > 0.9
    assert min(overlaps) > 0.65


def test_comma2k19_segment_from_ecef(real_data: Path, tmp_path: Path) -> None:
    route = next((real_data / "comma2k19" / "Example_1").iterdir())
    positions = np.load(route / "40" / "global_pose" / "frame_positions")
    lon, lat, _ = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(*positions[600])
    roi = Roi(scene_id="highway", longitude_deg=lon, latitude_deg=lat)
    report = ingest_recordings([route], [roi], tmp_path / "d")
    (drive,) = report.drives.values()
    (one,) = drive.passes
    ones = np.ones(len(positions))
    lons, lats, _ = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(*positions.T)
    inside = GEOD.inv(lons, lats, lon * ones, lat * ones)[2] <= 200.0
    assert one.poses == inside.sum()
    assert abs(one.duration_s - inside.sum() * 0.05) < 0.11
    assert one.accepted == (one.duration_s >= 10.0)
    speed = np.linalg.norm(np.load(route / "40" / "global_pose" / "frame_velocities")[inside], axis=1).mean()
    assert one.mean_speed_mps == pytest.approx(speed, rel=0.01)
    document = read_json(tmp_path / "d" / "drives" / drive.info.drive_id / "drive.json", DriveDocument)
    assert document.start_ns // 10**9 == 1_533_226_488


def test_a_copy_of_real_recordings_ends_with_the_same_bytes(real_data: Path, tmp_path: Path) -> None:
    loops = sorted((real_data / "boreas").glob("boreas-*"))
    rois = [propose_rois(loops, count=1).ranked[0].roi]
    ingest_recordings(loops, rois, tmp_path / "a")
    ingest_recordings(loops[::-1], rois, tmp_path / "b", IngestOptions(workers=1))
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
