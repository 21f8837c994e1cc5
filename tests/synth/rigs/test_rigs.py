"""Tests of the seven vehicle types: every pixel has a ray, and the cameras cover all directions."""

import numpy as np
import pytest

from mirror.geometry import angle_between_deg, matrix_from_quaternion
from mirror.recordings.calibration import Calibration
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.synth.errors import CameraClock, Errors
from mirror.synth.model import Label
from mirror.synth.rigs import VEHICLE_TYPES, Vehicle
from mirror.synth.rigs.ego_model import make_ego_model
from mirror.synth.rigs.mount import Optics, SensorRaster
from mirror.synth.truth.casting import cast_rays, ego_mask

RING = ("front_wide", "front_left", "rear_left", "rear", "rear_right", "front_right")
CLOCKS = {name: CameraClock(100 * place, 0) for place, name in enumerate(CANONICAL_CAMERAS)}
types = pytest.mark.parametrize("name", VEHICLE_TYPES)


def vehicle(name: str, width_px: int = 200, seed: int = 5) -> Vehicle:
    return Vehicle("v", VEHICLE_TYPES[name], width_px, seed)


def seen_at(one: Vehicle, distance_m: float) -> dict[str, np.ndarray]:
    azimuth = np.radians(np.arange(0.0, 360.0, 0.25))
    ring = np.stack([distance_m * np.cos(azimuth), distance_m * np.sin(azimuth), np.full_like(azimuth, 1.0)], axis=1)
    return {
        name: camera.project(one.ego_SE3_camera[name].inverse().transform(ring)[0]).valid
        for name, camera in one.cameras.items()
    }


def test_there_are_seven_types_of_seven_cameras_with_every_lens_model() -> None:
    assert len(VEHICLE_TYPES) == 7
    cameras = {name: vehicle(name).cameras for name in VEHICLE_TYPES}
    assert all(tuple(one) == CANONICAL_CAMERAS for one in cameras.values())
    models = {camera.model for one in cameras.values() for camera in one.values()}
    assert models == {"pinhole", "brown_conrady", "rational", "kannala_brandt", "f_theta"}
    shapes = {(one["front_wide"].width_px, one["front_wide"].height_px) for one in cameras.values()}
    assert len(shapes) >= 5


@types
@pytest.mark.parametrize("seed", range(4))
def test_neighbouring_cameras_overlap_and_cover_all_directions(name: str, seed: int) -> None:
    for distance_m in (20.0, 200.0):
        seen = seen_at(vehicle(name, seed=seed), distance_m)
        assert np.any(list(seen.values()), axis=0).all()
        for left, right in zip(RING, (*RING[1:], RING[0])):
            assert (seen[left] & seen[right]).sum() * 0.25 > 4.0, (left, right)
        assert (seen["front_narrow"] <= seen["front_wide"]).all()


@types
def test_every_pixel_has_a_ray_and_the_field_of_view_is_as_stated(name: str) -> None:
    one = vehicle(name, 320)
    for mount in one.kind.mounts:
        rays = one.cameras[mount.camera].rays()
        assert rays.valid.all()
        designed = mount.optics.camera(mount.raster, 320)
        middle = designed.unproject([[0.0, 0.5 * designed.height_px], [designed.width_px, 0.5 * designed.height_px]])
        ends = middle.direction
        angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(*ends)), ends[0] @ ends[1]))
        assert angle == pytest.approx(mount.optics.view_deg, abs=0.2)


@pytest.mark.parametrize(
    ("optics", "edge"),
    [
        (Optics("pinhole", 90.0), 1.0),
        (Optics("kannala_brandt", 120.0, (0.0, 0.0, 0.0, 0.0)), np.pi / 3),
        (Optics("f_theta", 120.0, (0.0, 1.0, 0.0, 0.1)), np.pi / 3 + 0.1 * (np.pi / 3) ** 3),
        (Optics("brown_conrady", 90.0, (-0.1, 0.02, 0.0, 0.0, 0.0)), 0.92),
    ],
)
def test_focal_lengths_match_the_closed_form(optics: Optics, edge: float) -> None:
    camera = optics.camera(SensorRaster(0.5, 2.0), 1000)
    assert (camera.width_px, camera.height_px) == (500, 250)
    focal = camera.distortion[1] if optics.model == "f_theta" else camera.fx_px
    assert focal == pytest.approx(250.0 / edge, rel=1e-12)


@types
def test_cameras_are_mounted_on_the_vehicle(name: str) -> None:
    one = vehicle(name)
    size = one.kind.size
    for camera, pose in one.ego_SE3_camera.items():
        x, y, z = pose.translation[0]
        assert -size.rear_m - 0.15 < x < size.length_m - size.rear_m
        assert abs(y) < 0.5 * size.width_m + 0.25
        assert 0.7 < z < size.height_m + 0.3, camera


@types
def test_vehicles_of_a_type_differ_within_tolerances(name: str) -> None:
    first, again, other = vehicle(name), vehicle(name), vehicle(name, seed=6)
    assert first.cameras == again.cameras
    for camera in CANONICAL_CAMERAS:
        angle = angle_between_deg(first.ego_SE3_camera[camera].rotation, other.ego_SE3_camera[camera].rotation)[0]
        assert 0.0 < angle < 2.5
        assert first.ego_SE3_camera[camera].rotation.tolist() == again.ego_SE3_camera[camera].rotation.tolist()
        one, two = first.cameras[camera], other.cameras[camera]
        assert one != two
        assert abs(one.cx_px - two.cx_px) < 0.04 * one.width_px


@types
def test_calibrations_are_valid_entries_and_exact_without_errors(name: str) -> None:
    one = vehicle(name)
    exact = one.true_calibration()
    for stage in ("factory", "online"):
        for entry, truth in zip(one.calibration(stage, Errors.none(), 3, CLOCKS), exact):
            assert Calibration(**entry).time_offset_ns == CLOCKS[entry["camera"]].offset_ns
            assert entry["covariance"] == [0.0] * 36
            # Quaternions are normalised when poses are composed.
            assert entry["ego_SE3_camera"] == pytest.approx(truth["ego_SE3_camera"], abs=1e-15)
            others = entry.keys() - {"covariance", "method", "time_offset_ns", "ego_SE3_camera"}
            assert all(entry[key] == truth[key] for key in others)
    factory = [one.calibration("factory", Errors(), drive, CLOCKS) for drive in (1, 2)]
    online = [one.calibration("online", Errors(), drive, CLOCKS) for drive in (1, 2)]
    assert factory[0] == factory[1]
    assert online[0] != online[1]
    assert online[0] == one.calibration("online", Errors(), 1, CLOCKS)
    assert [entry["fx_px"] for entry in factory[0]] == [entry["fx_px"] for entry in online[0]]


@types
def test_ego_masks_cover_every_pixel_that_shows_the_vehicle(name: str) -> None:
    one = vehicle(name, 120)
    own = make_ego_model(one.kind)
    assert set(own.faces["label"]) == {Label.EGO}
    count = 0
    for camera, lens in one.cameras.items():
        pose = one.ego_SE3_camera[camera]
        mask = ego_mask(own, lens, pose) > 0
        rays = lens.rays().direction @ matrix_from_quaternion(pose.rotation)[0].T
        centres = cast_rays(own, pose.translation[0], rays.reshape(-1, 3))[1].reshape(mask.shape) >= 0
        assert (centres <= mask).all()
        # The mask exceeds the vehicle only by the pixels that its edge crosses.
        grown = np.pad(centres, 1)
        near = np.any([np.roll(grown, (a, b), (0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1)], axis=0)[1:-1, 1:-1]
        assert (mask <= near).mean() > 0.995
        count += mask.any()
    assert count >= 1
