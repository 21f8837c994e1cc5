"""Grid, ECEF and offset bodies, against PROJ's geodesics and plain matrices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.errors import RecordingError
from mirror.geometry.geodesy import ecef_R_enu, geodetic_to_ecef, geodetic_to_utm, is_in_utm_domain, utm_to_geodetic
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import heading_deg, quaternion_from_heading_pitch_roll, quaternion_from_matrix, rotate
from mirror.recordings.coordinates import (
    FLU_FROM_CAMERA,
    FLU_FROM_FRD,
    normalise_rotations,
    to_ego_track,
    track_from_ecef,
    track_from_utm,
)
from mirror.recordings.protocol import Track
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.tabular import RecordingRows, read_rows

STAMP = np.array([0], np.int64)


@given(st.floats(-3.0, 3.0), st.floats(-70, 70), st.floats(0, 359.99))
def test_grid_headings_become_true_headings(from_meridian: float, latitude: float, heading: float) -> None:
    """The azimuth of PROJ's geodesic along a short step on the grid is the true heading."""
    longitude, north = -81.0 + from_meridian, latitude >= 0
    east, nor = (float(value[0]) for value in geodetic_to_utm([longitude], [latitude], 17, north))
    step = 10.0 * np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading))])
    grid = quaternion_from_heading_pitch_roll(np.array([heading]))
    here, there = (
        track_from_utm(STAMP, np.array([east + d[0]]), np.array([nor + d[1]]), None, grid, zone=17, north=north)
        for d in (0 * step, step)
    )
    assert here.longitude_deg is not None and here.latitude_deg is not None and here.rotation is not None
    assert there.longitude_deg is not None and there.latitude_deg is not None
    azimuth, _, _ = pyproj.Geod(ellps="WGS84").inv(
        here.longitude_deg[0], here.latitude_deg[0], there.longitude_deg[0], there.latitude_deg[0]
    )
    found = float(heading_deg(here.rotation)[0])
    assert abs((found - azimuth + 180) % 360 - 180) < 1e-4


def test_ecef_poses_become_east_north_up_poses() -> None:
    lon, lat, height = np.array([13.4, -122.4]), np.array([52.5, -37.7]), np.array([40.0, -3.0])
    enu = quaternion_from_heading_pitch_roll(np.array([30.0, 250.0]), np.array([2.0, -1.0]), np.array([0.5, 3.0]))
    ecef = quaternion_from_matrix(ecef_R_enu(lon, lat) @ np.stack([rotate(q, np.eye(3)).T for q in enu]))
    track = track_from_ecef(np.zeros(2, np.int64), geodetic_to_ecef(lon, lat, height), ecef)
    np.testing.assert_allclose(track.longitude_deg, lon, atol=1e-12)
    np.testing.assert_allclose(track.latitude_deg, lat, atol=1e-12)
    np.testing.assert_allclose(track.height_m, height, atol=1e-8)
    np.testing.assert_allclose(track.rotation, enu, atol=1e-14)


def test_missing_positions_stay_missing() -> None:
    rotation = quaternion_from_heading_pitch_roll(np.array([30.0, 30.0]))
    nan = np.array([np.nan, 500_000.0])
    track = track_from_utm(np.zeros(2, np.int64), nan, nan, None, rotation, zone=33, north=True)
    assert track.longitude_deg is not None and np.isnan(track.longitude_deg[0])
    assert track.rotation is not None and np.isfinite(track.rotation).all()
    position = np.stack([nan + 4e6, nan, nan + 4e6], axis=1)
    track = track_from_ecef(np.zeros(2, np.int64), position, rotation)
    assert track.rotation is not None and np.isfinite(track.rotation).all()
    assert track.latitude_deg is not None and np.isnan(track.latitude_deg[0]) and np.isfinite(track.latitude_deg[1])


def test_body_axes_become_forward_left_up() -> None:
    np.testing.assert_allclose(rotate(FLU_FROM_FRD, np.eye(3)), np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    right, down, forward = rotate(FLU_FROM_CAMERA, np.eye(3))
    np.testing.assert_allclose([right, down, forward], [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-15)


@pytest.mark.parametrize("height", [None, np.array([100.0])])
def test_poses_of_a_roof_antenna_become_poses_of_the_rear_axle(height: np.ndarray | None) -> None:
    """2 m ahead and 1.5 m above the axle, heading east: the axle is 2 m west of it."""
    heading = quaternion_from_heading_pitch_roll(np.array([90.0]))
    body = Track(STAMP, np.array([13.4]), np.array([52.5]), height_m=height, rotation=heading)
    ego = to_ego_track(body, Poses(np.array([[1.0, 0, 0, 0]]), np.array([[2.0, 0.0, 1.5]])))
    assert ego.longitude_deg is not None and ego.latitude_deg is not None
    azimuth, _, distance = pyproj.Geod(ellps="WGS84").inv(13.4, 52.5, ego.longitude_deg[0], ego.latitude_deg[0])
    assert abs(distance - 2.0) < 1e-3
    assert abs(abs(azimuth) - 90) < 1e-3
    assert (ego.height_m is None) == (height is None)
    if ego.height_m is not None:
        assert abs(ego.height_m[0] - 98.5) < 1e-6


def test_an_offset_in_a_local_frame_is_a_product_of_poses() -> None:
    generator = np.random.default_rng(1)
    world_SE3_ego = Poses(generator.normal(size=(20, 4)), generator.normal(size=(20, 3)) * 1e4)
    ego_SE3_body = Poses(generator.normal(size=(1, 4)), generator.normal(size=(1, 3)))
    body = world_SE3_ego @ ego_SE3_body
    x, y, z = body.translation.T
    track = Track(np.arange(20), x_m=x, y_m=y, height_m=z, rotation=body.rotation)
    found = to_ego_track(track, ego_SE3_body)
    np.testing.assert_allclose(
        np.stack([found.x_m, found.y_m, found.height_m], 1), world_SE3_ego.translation, atol=1e-8
    )
    np.testing.assert_allclose(found.rotation, world_SE3_ego.rotation, atol=1e-12)


def test_an_offset_needs_an_orientation() -> None:
    body = Track(STAMP, np.array([13.4]), np.array([52.5]))
    identity = np.array([[1.0, 0, 0, 0]])
    assert to_ego_track(body, Poses(identity, np.zeros((1, 3)))) is body
    with pytest.raises(RecordingError, match="no orientation"):
        to_ego_track(body, Poses(identity, np.ones((1, 3))))


@pytest.mark.parametrize("bad", ["0,0,0,0", "nan,0,0,0", ",0,0,0", "0.5,0,0,0", "1e300,0,0,0"])
def test_invalid_rotation_is_named_by_its_line(tmp_path: Path, bad: str) -> None:
    def quaternions(text: str) -> tuple[RecordingRows, np.ndarray]:
        (tmp_path / "poses.csv").write_text(f"qw,qx,qy,qz\n{text}")
        rows = read_rows([tmp_path / "poses.csv"], types={})
        return rows, np.stack([rows.floats(name) for name in ("qw", "qx", "qy", "qz")], axis=1)

    rows, good = quaternions("1,0,0,0\n0.7071068,0.7071068,0,0\n-1,0,0,0\n")
    np.testing.assert_allclose(np.linalg.norm(normalise_rotations(good, rows, "qw"), axis=1), 1.0, atol=1e-15)
    assert (normalise_rotations(good, rows, "qw")[:, 0] >= 0).all()
    rows, wrong = quaternions(f"1,0,0,0\n{bad}\n")
    with pytest.raises(RecordingError, match="no rotation") as caught:
        normalise_rotations(wrong, rows, "qw")
    assert caught.value.place == "line 3, column qw"


@pytest.mark.parametrize(
    ("easting", "northing", "north"),
    [
        (-109_000.0, 5_332_000.0, True),  # without the false easting
        (691_000.0, -4_170_000.0, False),  # without the false northing
        (5_000_000.0, 5_332_000.0, True),
        (691_000.0, 53_320_000.0, True),  # a digit too many
        (np.inf, 5_332_000.0, True),
    ],
)
def test_coordinates_outside_the_domain_of_utm_have_no_place(easting: float, northing: float, north: bool) -> None:
    lon, lat = utm_to_geodetic([easting, 5e5], [northing, 4e6], 32, north)
    assert np.isnan([lon[0], lat[0]]).all() and np.isfinite([lon[1], lat[1]]).all()
    faults = RowFaults(2)
    easting_m, northing_m = np.array([5e5, easting]), np.array([4e6, northing])
    track = track_from_utm(np.arange(2), easting_m, northing_m, None, None, zone=32, north=north, faults=faults)
    kept = faults.drop_from(track)
    assert len(kept) == 1 and kept.bad is not None and kept.bad.counts() == {"position": 1}
    with pytest.raises(RecordingError, match="no place of a UTM zone") as caught:
        track_from_utm(np.arange(2), easting_m, northing_m, None, None, zone=32, north=north, file=Path("poses.csv"))
    assert (caught.value.file, caught.value.place) == ("poses.csv", "row 1")


def test_the_domain_of_utm_has_every_place_of_a_zone_and_its_neighbourhood() -> None:
    lon, lat = (axis.ravel() for axis in np.meshgrid(np.linspace(5.5, 12.5, 15), np.linspace(-80.0, 84.0, 165)))
    for north in (True, False):
        assert is_in_utm_domain(*geodetic_to_utm(lon, lat, 32, north), north).all()
    assert not is_in_utm_domain([np.nan], [0.0], True).any()


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.0), (4_177.0, 855.0, 4_728.0), (np.inf, 0.0, 0.0)])
def test_ecef_positions_off_the_ground_are_bad_rows(position: tuple[float, float, float]) -> None:
    faults = RowFaults(2)
    places = np.stack([geodetic_to_ecef([11.6], [48.1], [500.0])[0], position])
    track = faults.drop_from(track_from_ecef(np.arange(2), places, None, faults=faults))
    assert len(track) == 1 and track.bad is not None and track.bad.counts() == {"position": 1}
