"""Propagation along tracks and to other cameras, against exact geometry."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.privacy.propagation.cameras import PosedCamera, project_to_cameras
from mirror.privacy.propagation.tracks import follow_tracks
from mirror.privacy.regions import Region, covered_share, region_at

SIZE = (960, 540)
CAMERA = Camera("pinhole", *SIZE, 700.0, 700.0, 480.0, 270.0)
STEP_NS = 100_000_000


def moving(image: int, kind: str = "face") -> Region:
    left, top = 100.0 + 12.0 * image, 80.0 - 2.0 * image
    return region_at((left, top, left + 20.0, top + 26.0), kind, score=0.8, source="d")


@pytest.mark.parametrize("missing", [{2}, {2, 3}, {4}])
def test_a_track_fills_gaps_and_goes_on_at_both_ends(missing: set[int]) -> None:
    images = [[] if k in missing or k in (0, 7) else [moving(k)] for k in range(8)]
    added = follow_tracks(images, [k * STEP_NS for k in range(8)], SIZE)
    for number in range(8):
        if images[number]:
            assert added[number] == []
        else:
            (region,) = added[number]
            assert region.origin == "track" and covered_share(moving(number).box_px, [region.box_px]) == 1.0
            assert region.size_px == pytest.approx((25.0, 32.5))


def test_uneven_times_are_respected() -> None:
    times = [0, STEP_NS, 4 * STEP_NS, 5 * STEP_NS]
    images = [[moving(0)], [moving(1)], [], [moving(5)]]
    (region,) = follow_tracks(images, times, SIZE)[2]
    assert covered_share(moving(4).box_px, [region.box_px]) == 1.0


def test_what_is_no_track_adds_nothing() -> None:
    far = region_at((600.0, 300.0, 620.0, 326.0), "face")
    large = region_at((100.0, 80.0, 180.0, 190.0), "face")
    for second in (far, large, moving(1, "plate")):
        assert follow_tracks([[moving(0)], [second], []], [0, STEP_NS, 2 * STEP_NS], SIZE) == [[], [], []]
    assert follow_tracks([], [], SIZE) == [] and follow_tracks([[moving(0)]], [5], SIZE) == [[]]
    leaving = [[region_at((930.0 + 12 * k, 80.0, 950.0 + 12 * k, 106.0), "face")] if k < 2 else [] for k in range(3)]
    (region,) = follow_tracks(leaving, [0, STEP_NS, 2 * STEP_NS], SIZE)[2] or (None,)
    assert region is None or region.right_px <= 960.0


def at(x_m: float, yaw_deg: float = 0.0) -> Poses:
    half = np.radians(yaw_deg) / 2
    return Poses(np.array([[np.cos(half), 0.0, np.sin(half), 0.0]]), np.array([[x_m, 0.0, 0.0]]))


@pytest.mark.parametrize("distance_m", [4.0, 8.0, 15.0])
@pytest.mark.parametrize("kind", ["face", "plate"])
def test_a_region_is_found_in_the_other_camera(distance_m: float, kind: str) -> None:
    size = np.array([0.16, 0.22]) if kind == "face" else np.array([0.46, 0.12])
    corners = np.array([[u * size[0] / 2, v * size[1] / 2, 0.0] for u in (-1, 1) for v in (-1, 1)])
    corners += np.array([0.6, -0.2, distance_m])
    views = {"one": PosedCamera(CAMERA, at(0.0)), "two": PosedCamera(CAMERA, at(0.5, 6.0))}
    boxes = {}
    for name, view in views.items():
        pixels = view.camera.project(view.world_SE3_camera.inverse().transform(corners)[0]).uv_px
        boxes[name] = [*pixels.min(axis=0), *pixels.max(axis=0)]
    added = project_to_cameras({"one": [region_at(boxes["one"], kind)], "two": []}, views)
    (region,) = added["two"]
    assert region.origin == "camera" and covered_share(boxes["two"], [region.box_px]) >= 0.9
    known = {"one": [region_at(boxes["one"], kind)], "two": [region_at(region.box_px, kind)]}
    assert project_to_cameras(known, views)["two"] == []


def test_cameras_without_overlap_or_pose_add_nothing() -> None:
    region = region_at((480.0, 200.0, 500.0, 226.0), "face")
    views = {"one": PosedCamera(CAMERA, at(0.0)), "back": PosedCamera(CAMERA, at(0.0, 180.0))}
    assert project_to_cameras({"one": [region], "back": [], "lost": [region]}, views) == {"one": [], "back": []}
    assert project_to_cameras({"one": [region]}, {}) == {}
