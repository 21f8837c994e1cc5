"""The fallback for number plates at the boxes of vehicles, against the projection of plates at known places."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera
from mirror.privacy.propagation.bodies import find_hidden
from mirror.privacy.propagation.mounts import find_mount, is_vehicle
from mirror.privacy.propagation.vehicles import StripOptions, plate_strips
from mirror.privacy.regions import Region, covered_share, grown_box, region_at

SIZE = (960, 540)
CAMERA = Camera("pinhole", *SIZE, 700.0, 700.0, 480.0, 270.0)
CAR = np.array([[4.4, 1.8, 1.5]])
EYE_M = 1.6


def vehicle(distance_m: float, yaw_deg: float, aside_m: float = 0.0) -> Poses:
    """The box of `CAR` on the road ahead, its x axis turned by an angle from towards the camera."""
    yaw = np.radians(yaw_deg)
    forward = np.array([np.sin(yaw), 0.0, -np.cos(yaw)])
    up = np.array([0.0, -1.0, 0.0])
    turn = np.stack([forward, np.cross(up, forward), up], axis=1)
    place = np.array([[aside_m, EYE_M - 0.5 * CAR[0, 2], distance_m]])
    return Poses(quaternion_from_matrix(turn[None]), place)


def joined(*boxes: Poses) -> Poses:
    return Poses(np.concatenate([box.rotation for box in boxes]), np.concatenate([box.translation for box in boxes]))


def plate_box(box: Poses, end: float, low_m: float, depth_m: float = 0.05) -> list[float]:
    """Bounds of a plate of 0.52 x 0.11 m at an end of `CAR`, in the image."""
    corners = [(end * (2.2 - depth_m), y, low_m + z - 0.75) for y in (-0.26, 0.26) for z in (0.0, 0.11)]
    pixels = CAMERA.project(box.transform(np.array(corners))[0]).uv_px
    return [*pixels.min(axis=0).tolist(), *pixels.max(axis=0).tolist()]


def removed(strips: list[Region], grow: float = 0.3) -> list[tuple[int, int, int, int]]:
    return [box for strip in strips if (box := grown_box(strip, grow, *SIZE)) is not None]


@pytest.mark.parametrize("yaw_deg", [0.0, 35.0, -50.0, 180.0, 215.0])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_plate_anywhere_on_its_mount_is_removed(yaw_deg: float, share: float) -> None:
    box = vehicle(9.0, yaw_deg)
    end = 1.0 if np.cos(np.radians(yaw_deg)) > 0.0 else -1.0
    # The lower edges of the lowest and the highest plate: bumpers at the front, and tailgates too at the rear.
    low, high = (0.30, 0.59) if end > 0.0 else (0.35, 0.94)
    (region,) = strips = plate_strips(CAMERA, box, CAR, ["car"], [])
    assert (region.kind, region.origin) == ("plate", "vehicle")
    assert covered_share(plate_box(box, end, low + share * (high - low)), removed(strips)) >= 0.97
    height = (0.4 if end > 0.0 else 0.7) * 700.0 / 6.5
    assert region.size_px[1] * 1.3 < 1.15 * height


def test_a_plate_at_the_edge_of_the_image_is_removed() -> None:
    # The lower part of the strip is below the image; what is left of it must not be enlarged by less.
    box = vehicle(4.4, 180.0)
    true = plate_box(box, -1.0, 0.70)
    assert true[1] < SIZE[1] < true[3]
    cut = np.clip(true, 0.0, np.tile(SIZE, 2)).tolist()
    assert covered_share(cut, removed(plate_strips(CAMERA, box, CAR, ["car"], []))) >= 0.99


def test_what_is_removed_is_the_same_however_regions_are_enlarged() -> None:
    one, other = (
        removed(plate_strips(CAMERA, vehicle(9.0, 0.0), CAR, ["car"], [], grow=grow), grow)[0] for grow in (0.15, 1.0)
    )
    assert np.abs(np.subtract(one, other)).max() <= 2


def test_a_detected_plate_replaces_the_strip_if_size_and_place_are_right() -> None:
    box = vehicle(9.0, 0.0)
    true = np.array(plate_box(box, 1.0, 0.45))
    width, height = true[2] - true[0], true[3] - true[1]
    half = true.copy()
    half[2] -= 0.5 * width
    flat = true.copy()
    flat[1] += 0.4 * height
    larger = true + np.array([-width, -3.0 * height, width, 3.0 * height])
    lamp, badge = true + (0.6 * width) * np.array([1.0, 0.0, 1.0, 0.0]), true - np.array([0.0, 90.0, 0.0, 90.0])
    (whole,) = plate_strips(CAMERA, box, CAR, ["car"], [])
    for score in (0.1, 0.9):
        assert plate_strips(CAMERA, box, CAR, ["car"], [region_at(true.tolist(), "plate", score=score)]) == []
        for other in (half, flat, larger, lamp, badge):
            found = region_at(other.tolist(), "plate", score=score)
            strips = plate_strips(CAMERA, box, CAR, ["car"], [found])
            assert covered_share(true.tolist(), removed(strips)) >= 0.99
            # A detector that is sure of a part of a plate tells its height.
            is_lower = strips[0].size_px[1] < 0.9 * whole.size_px[1]
            assert is_lower == ((other is half or other is flat) and score > 0.5)
    assert len(plate_strips(CAMERA, box, CAR, ["car"], [region_at(true.tolist(), "face")])) == 1


def test_who_has_no_plate_or_shows_none() -> None:
    assert plate_strips(CAMERA, vehicle(9.0, 90.0), CAR, ["car"], []) == []
    assert plate_strips(CAMERA, vehicle(9.0, 0.0), CAR, ["pedestrian"], []) == []
    assert plate_strips(CAMERA, vehicle(-9.0, 0.0), CAR, ["car"], []) == []
    assert plate_strips(CAMERA, vehicle(9.0, 0.0, aside_m=6.0), CAR, ["car"], []) == []
    assert plate_strips(CAMERA, vehicle(9.0, 0.0)[:0], CAR[:0], [], []) == []
    assert is_vehicle("Vehicle.Car") and is_vehicle("large truck") and not is_vehicle("cyclist")
    for name in ("trailer", "vehicle.motorcycle"):
        assert find_mount(name, 1.5, is_front=True) is None and find_mount(name, 1.5, is_front=False) is not None
    assert find_mount("bicycle", 1.7, is_front=False) is None
    highest = [find_mount(name, height, is_front=True) for name, height in (("car", 1.5), ("car", 1.8), ("truck", 3.0))]
    levels = [mount.high_m for mount in highest if mount is not None]
    assert levels == sorted(set(levels)) and len(levels) == 3


@pytest.mark.parametrize("least_px", [20.0, 32.0])
def test_a_strip_begins_where_its_plate_is_large_enough(least_px: float) -> None:
    # The front end, from whose middle a plate of 0.52 m appears with this width.
    distance = 0.52 * 700.0 / least_px + 2.2
    options = StripOptions(least_px=least_px)
    assert plate_strips(CAMERA, vehicle(distance + 0.2, 0.0), CAR, ["car"], [], options) == []
    assert len(plate_strips(CAMERA, vehicle(distance - 0.2, 0.0), CAR, ["car"], [], options)) == 1
    with pytest.raises(UsageError):
        StripOptions(least_px=0.0)
    with pytest.raises(UsageError):
        StripOptions(box_error_m=-0.1)


def test_vehicles_behind_others_have_no_strip() -> None:
    sizes, names = np.repeat(CAR, 2, axis=0), ["car", "car"]
    behind = joined(vehicle(7.0, 180.0), vehicle(13.0, 180.0))
    beside = joined(vehicle(7.0, 180.0), vehicle(13.0, 180.0, aside_m=3.5))
    twice = joined(vehicle(7.0, 180.0), vehicle(7.5, 180.0))
    assert len(plate_strips(CAMERA, behind, sizes, names, [])) == 1
    # What may be empty above its frame hides nothing; neither do people.
    assert len(plate_strips(CAMERA, behind, sizes, ["truck", "car"], [])) == 2
    assert len(plate_strips(CAMERA, behind, sizes, ["pedestrian", "car"], [])) == 1
    assert len(plate_strips(CAMERA, beside, sizes, names, [])) == 2
    # Two boxes of one vehicle do not hide each other's plates.
    assert len(plate_strips(CAMERA, twice, sizes, names, [])) == 2


@pytest.mark.parametrize("margin_m", [0.0, 0.3])
def test_hidden_points_are_those_whose_line_passes_a_body(margin_m: float) -> None:
    # The reference walks along each line.
    rng = np.random.default_rng(3)
    boxes = joined(vehicle(7.0, 20.0), vehicle(8.0, -70.0, aside_m=3.0), vehicle(6.0, 0.0, aside_m=-3.0))
    size = np.array([6.0, 2.6, 2.6])
    sizes, names = np.repeat(size[None], 3, axis=0), ["car", "vehicle.bus", "person"]
    points = rng.uniform((-6.0, -1.0, 5.0), (6.0, 1.6, 14.0), (150, 3))
    steps = np.linspace(0.0, 1.0, 1001)[1:, None, None] * points
    expected = np.zeros(len(points), np.bool_)
    for row in range(2):
        local = boxes[row : row + 1].inverse().transform(steps.reshape(-1, 3))[0].reshape(steps.shape)
        side = np.array([0.2 + margin_m, 0.2 + margin_m, margin_m])
        for low, high in (((-0.5, -0.5, -0.4), (0.5, 0.5, 0.05)), ((-0.3, -0.45, 0.0), (0.15, 0.45, 0.4))):
            inside = ((local >= low * size + side) & (local <= high * size - side)).all(axis=-1)
            expected |= inside.any(axis=0) & ~inside[-1]
    hidden = find_hidden(points, boxes, sizes, names, margin_m=margin_m)
    assert 15 < expected.sum() < 135
    assert (hidden != expected).sum() <= 1


def test_a_stated_error_of_boxes_keeps_the_plate_in_the_strip() -> None:
    rng, error = np.random.default_rng(5), 0.3
    for _ in range(20):
        true = vehicle(9.0, 180.0 + rng.uniform(-30.0, 30.0))
        shift = rng.uniform(-error, error, 3) / np.sqrt(2.0)
        box = Poses(true.rotation, true.translation + shift)
        strips = plate_strips(CAMERA, box, CAR, ["car"], [], StripOptions(box_error_m=error))
        assert covered_share(plate_box(true, -1.0, 0.80), removed(strips)) >= 0.99
