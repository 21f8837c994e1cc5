"""Tests of drives through traffic: smooth motion, no overlaps, and every branch of the trigger."""

from functools import lru_cache

import numpy as np
import pytest
from shapely import STRtree, polygons

from mirror.geometry import matrix_from_quaternion
from mirror.geometry.geodesy import TangentFrame
from mirror.ingest.clean import clean
from mirror.ingest.trigger import RoiTrigger
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions
from mirror.synth.driving.journey import Journey, simulate_journey
from mirror.synth.driving.site import TrafficDensity, TrafficSite
from mirror.traffic.placement.trace import Chassis, TraceMotion
from tests.traffic import street

SITE = TrafficSite(street.network(), street.RADIUS, street.heights, np.array([[60.0, 8.0]]))
EGO = Chassis(4.7, 1.9, 2.8, 0.95, 0.0)
ROI = Roi(scene_id="a", longitude_deg=8.0, latitude_deg=49.0, radius_m=street.RADIUS)


@lru_cache
def journey_of(route: str, seed: int = 1) -> Journey:
    return simulate_journey(SITE, route, EGO, seed, fastest_mps=14.0, aside_m=0.1)


def footprints(boxes: list[tuple[float, ...]]) -> np.ndarray:
    """Polygons (N,) of boxes (length, width, x, y, yaw), made in one call of shapely."""
    length, width, x, y, yaw = np.array(boxes).T[..., None]
    along, left = length / 2 * (1, -1, -1, 1), width / 2 * (1, 1, -1, -1)
    corners = x + np.cos(yaw) * along - np.sin(yaw) * left, y + np.sin(yaw) * along + np.cos(yaw) * left
    return polygons(np.stack(corners, axis=-1))


@pytest.mark.parametrize("route", ["along", "turn", "left"])
def test_road_users_do_not_overlap(route) -> None:
    journey = journey_of(route)
    assert sum(isinstance(user.motion, TraceMotion) for user in journey.road_users) > 15
    for time_s in np.arange(0.0, journey.drive.duration_s, 0.5):
        along, _ = journey.drive.schedule.at(np.array([time_s]))
        (x, y, _, yaw, _, _), ahead = journey.drive.trace.at(along)[0][0], 0.5 * EGO.length_m - EGO.rear_overhang_m
        boxes = [(EGO.length_m, EGO.width_m, x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), yaw)]
        for user in journey.road_users:
            at = user.motion.at(float(time_s))
            if np.hypot(at.x_m, at.y_m) < street.RADIUS + 50.0:
                boxes.append((*user.body.size_m[:2], at.x_m, at.y_m, at.yaw_rad))
        shapes = footprints(boxes)
        pairs = STRtree(shapes).query(shapes, predicate="intersects").T
        assert all(a == b for a, b in pairs), (route, time_s)


@pytest.mark.parametrize("route", ["along", "turn", "twice", "uturn", "corner"])
def test_motion_is_smooth_and_faces_forward(route) -> None:
    drive = journey_of(route).drive
    step = 0.01
    time_s = np.arange(0.0, drive.duration_s, step)
    poses = drive.poses(time_s)
    velocity = np.diff(poses.translation, axis=0) / step
    speed = np.linalg.norm(velocity, axis=1)
    forward = matrix_from_quaternion(poses.rotation)[:, :, 0]
    yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    rate = np.diff(yaw) / step
    assert speed.max() < 14.5
    pull = np.diff(speed) / step
    assert pull.min() > -4.0
    assert pull.max() < 2.6
    assert np.abs(rate * speed).max() < 3.0
    assert np.abs(np.diff(rate)).max() / step < 2.5
    cosine = np.sum(velocity * (forward[:-1] + forward[1:]) / 2, axis=1) / np.maximum(speed, 1e-9)
    assert cosine[speed > 0.5].min() > 0.998
    assert drive.speeds_mps(time_s[:-1] + step / 2) == pytest.approx(speed, abs=0.02)
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.12


def test_recording_vehicle_stands_on_the_ground() -> None:
    drive = journey_of("turn").drive
    poses = drive.poses(np.linspace(0.0, drive.duration_s, 60))
    height = street.heights(poses.translation[:, 0], poses.translation[:, 1])
    assert poses.translation[:, 2] == pytest.approx(height, abs=0.01)
    up = matrix_from_quaternion(poses.rotation)[:, 2, 2]
    assert np.degrees(np.arccos(up)).max() < 3.5


def test_other_road_users_stand_on_the_ground_and_move_plausibly() -> None:
    journey = journey_of("along")
    times = np.arange(0.0, journey.drive.duration_s, 0.1)
    for user in journey.road_users:
        if not isinstance(user.motion, TraceMotion):
            continue
        placed, _ = user.motion.trace.at(user.motion.schedule.at(times)[0])
        near = np.hypot(*placed[:, :2].T) < street.EXTENT
        assert placed[near, 2] == pytest.approx(street.heights(*placed[near, :2].T), abs=0.12)
        speed = user.motion.schedule.at(times)[1]
        assert speed.min() > -1e-9
        assert np.abs(np.diff(speed)).max(initial=0.0) < 0.75


TIMED = ("edge", "corner", "still", "uturn")
EXPECTED = {
    "along": [(None, False)],
    "back": [(None, False)],
    "turn": [(None, False)],
    "left": [(None, False)],
    "across": [(None, False)],
    "twice": [(None, False), (None, False)],
    "edge": [("min_duration", False)],
    "corner": [("min_duration", False)],
    "still": [("min_path", False)],
    "uturn": [("min_duration", True), ("min_duration", True)],
}


@pytest.mark.parametrize("route", sorted(EXPECTED))
def test_routes_reach_every_branch_of_the_trigger(route) -> None:
    for seed in (1, 2) if route in TIMED else (1,):
        drive = journey_of(route, seed).drive
        time_s = np.arange(0.0, drive.duration_s, 0.05)
        longitude, latitude, height = TangentFrame(8.0, 49.0).to_geodetic(drive.poses(time_s).translation)
        stamps = 1_700_000_000_000_000_000 + np.round(time_s * 1e9).astype(np.int64)
        track, _ = clean(Track(stamps, longitude, latitude, height_m=height), CleaningOptions())
        passes = RoiTrigger([ROI], TriggerOptions(), CleaningOptions()).passes(track)
        assert [(one.rule, one.split) for one in passes] == EXPECTED[route]


def test_journeys_repeat_with_the_seed_and_differ_without() -> None:
    first, again, other = journey_of("turn"), journey_of.__wrapped__("turn"), journey_of("turn", 2)
    assert np.array_equal(first.drive.schedule.along_m, again.drive.schedule.along_m)
    assert [user.track_id for user in first.road_users] == [user.track_id for user in again.road_users]
    for a, b in zip(first.road_users, again.road_users):
        assert a.motion.at(7.3) == b.motion.at(7.3)
    assert {user.motion.at(1.0) for user in first.road_users} != {user.motion.at(1.0) for user in other.road_users}


def test_there_are_few_road_users_at_night() -> None:
    quiet = simulate_journey(SITE, "along", EGO, 1, fastest_mps=14.0, bustle=TrafficDensity(0.15, 0.1))
    moving = [user for user in quiet.road_users if isinstance(user.motion, TraceMotion)]
    assert len(moving) < 0.5 * sum(isinstance(user.motion, TraceMotion) for user in journey_of("along").road_users)
    alone = simulate_journey(SITE, "along", EGO, 1, fastest_mps=14.0, bustle=TrafficDensity(0.0, 0.0))
    assert not any(isinstance(user.motion, TraceMotion) for user in alone.road_users)
