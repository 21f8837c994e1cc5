"""Drives as they truly were: smooth, on the road, through nobody, and meeting every branch of the trigger."""

import numpy as np
import pytest
from shapely import affinity
from shapely.geometry import Polygon, box

from mirror.ingest.clean import clean
from mirror.ingest.trigger import Trigger
from mirror.recordings.folder import FolderReader
from mirror.schema.documents import CleaningOptions, TriggerOptions
from mirror.schema.files import write_json
from mirror.synth.fleet import SynthDrive, drives_of
from mirror.synth.presets import PRESETS
from mirror.synth.recordings import _document, _write_poses
from mirror.synth.road_users import Placement

DEMO = drives_of("demo", 0)[1]
EGO_LENGTH, EGO_WIDTH, REAR_OVERHANG = 4.7, 1.86, 1.0


def footprint(length: float, width: float, at: Placement) -> Polygon:
    turned = affinity.rotate(box(-length / 2, -width / 2, length / 2, width / 2), at.yaw_rad, (0, 0), use_radians=True)
    return affinity.translate(turned, at.x_m, at.y_m)


def ego_footprint(drive: SynthDrive, time_s: float) -> Polygon:
    points, yaw = drive.truth.on_line(drive.truth.driven_m(np.array([time_s])))
    ahead = 0.5 * EGO_LENGTH - REAR_OVERHANG
    middle = points[0] + ahead * np.array([np.cos(yaw[0]), np.sin(yaw[0])])
    return footprint(EGO_LENGTH, EGO_WIDTH, Placement(*middle, float(yaw[0]), 0.0))


@pytest.mark.parametrize("drive", [d for d in DEMO if d.recipe.pictures], ids=lambda drive: drive.drive_id)
def test_the_vehicle_drives_through_nobody(drive: SynthDrive) -> None:
    for time_s in np.arange(0.0, drive.truth.duration_s, 0.5):
        own = ego_footprint(drive, time_s)
        for user in (*drive.users, *drive.world.parked):
            at = user.motion.at(float(time_s))
            if np.hypot(at.x_m - own.centroid.x, at.y_m - own.centroid.y) < 12.0:
                other = footprint(user.body.size_m[0], user.body.size_m[1], at)
                assert not own.intersects(other), (user.track_id, time_s)


@pytest.mark.parametrize("drive", DEMO, ids=lambda drive: drive.drive_id)
def test_motion_is_smooth_and_faces_forward(drive: SynthDrive) -> None:
    time_s = np.arange(0.1, drive.truth.duration_s - 0.1, 0.05)
    poses = drive.truth.poses(time_s)
    step = np.diff(poses.translation, axis=0)
    speed = np.linalg.norm(step, axis=1) / 0.05
    assert speed.max() < 20.0
    assert np.abs(np.diff(speed)).max() / 0.05 < 6.0
    moving = speed > 1.0
    forward = poses.transform(np.array([[1.0, 0.0, 0.0]]))[:, 0] - poses.translation
    cosine = np.sum(step * (forward[:-1] + forward[1:]) / 2, axis=1) / np.maximum(np.linalg.norm(step, axis=1), 1e-9)
    assert cosine[moving].min() > 0.985


def test_bodies_lie_within_their_boxes() -> None:
    seen = set()
    for drive in DEMO:
        for user in (*drive.users, *drive.world.parked):
            body, half = user.body, np.array(user.body.size_m) / 2
            seen.add(body.category)
            signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
            for part in body.solids:
                corners = part["centre"] + (signs * part["half"]) @ part["axes"]
                over = np.abs(corners - [0, 0, half[2]]) - half
                assert over.max() < 1e-9, (body.category, part["material"], over.max(axis=0))
    assert seen == {"car", "van", "truck", "bus", "pedestrian", "cyclist"}


def verdicts(drive: SynthDrive, folder) -> list[tuple[str | None, bool]]:
    _write_poses(folder, drive, PRESETS["demo"])
    bare = {"cameras": {}, "reference_camera": None, "rig_id": None}
    write_json(folder / "recording.json", {**_document(drive), **bare})
    track = FolderReader().open(folder, {}).track()
    options, cleaning = TriggerOptions(), CleaningOptions()
    clean_track, report = clean(track, cleaning)
    assert report.kept == report.poses or drive.recipe.route == "still"
    return [(one.rule, one.split) for one in Trigger([drive.world.roi], options, cleaning).passes(clean_track)]


def test_the_routes_meet_every_branch_of_the_trigger(tmp_path) -> None:
    expected = {
        "along": [(None, False)],
        "back": [(None, False)],
        "turn": [(None, False)],
        "twice": [(None, False), (None, False)],
        "edge": [("min_duration", False)],
        "corner": [("min_duration", False)],
        "still": [("min_path", False)],
        "uturn": [("min_duration", True), ("min_duration", True)],
    }
    met = set()
    for drive in DEMO:
        assert verdicts(drive, tmp_path / drive.drive_id) == expected[drive.recipe.route], drive.drive_id
        met.add(drive.recipe.route)
    assert met == set(expected)
    accepted = [d for d in DEMO if d.recipe.pictures and d.recipe.route != "corner"]
    assert len([d for d in accepted if d.world.roi.scene_id == "guangzhou-urban"]) == 5


def test_other_seeds_and_numbers() -> None:
    first, again, other = (drives_of("tiny", seed)[1] for seed in (0, 0, 1))
    assert [d.condition for d in first] == [d.condition for d in again]
    assert first[0].condition.start_ns != other[0].condition.start_ns
    many = drives_of("demo", 0, scenes=1, traversals=9)[1]
    assert len({(d.condition.start_ns // 86_400_000_000_000, d.vehicle.vehicle_id) for d in many}) == len(many)
