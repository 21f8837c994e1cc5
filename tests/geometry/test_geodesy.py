from __future__ import annotations

import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.geometry.geodesy import (
    TangentFrame,
    ecef_R_enu,
    ecef_to_geodetic,
    geodesic_circle,
    geodetic_to_ecef,
    geodetic_to_utm,
    mean_radius_m,
    surface_distance_m,
    utm_convergence_rad,
    utm_to_geodetic,
)
from tests.draws import draws

GEOD = pyproj.Geod(ellps="WGS84")
TO_ECEF = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
RNG = np.random.default_rng(3)
LON, LAT = RNG.uniform(-180, 180, 5000), RNG.uniform(-89.9, 89.9, 5000)
HEIGHT = RNG.uniform(-400, 9000, 5000)


def test_ecef_agrees_with_proj_and_inverts() -> None:
    xyz = geodetic_to_ecef(LON, LAT, HEIGHT)
    assert np.abs(xyz - np.column_stack(TO_ECEF.transform(LON, LAT, HEIGHT))).max() < 1e-8
    lon, lat, height = ecef_to_geodetic(xyz)
    assert np.abs(lon - LON).max() < 1e-10
    assert np.abs(lat - LAT).max() < 1e-11
    # PROJ's closed form is good to a micrometre.
    assert np.abs(height - HEIGHT).max() < 2e-6


@pytest.mark.parametrize(("metres", "error"), [(1e-3, 1e-8), (200.0, 2e-8), (2_000.0, 2e-7), (20_000.0, 1e-4)])
def test_short_distances_agree_with_karney(metres: float, error: float) -> None:
    to_lon, to_lat, _ = GEOD.fwd(LON, LAT, RNG.uniform(0, 360, 5000), np.full(5000, metres))
    assert np.abs(surface_distance_m(to_lon, to_lat, LON, LAT) - metres).max() < error


def test_distance_across_the_antimeridian_and_the_pole() -> None:
    assert surface_distance_m(-179.9999, 10.0, 179.9999, 10.0) == pytest.approx(
        GEOD.inv(-179.9999, 10, 179.9999, 10)[2]
    )
    assert surface_distance_m(0.0, 89.9999, 180.0, 89.9999) == pytest.approx(GEOD.inv(0, 89.9999, 180, 89.9999)[2])
    assert surface_distance_m(7.0, 50.0, 7.0, 50.0) == 0.0
    assert np.isnan(surface_distance_m(np.nan, 50.0, 7.0, 50.0))


def test_mean_radius_at_pole_and_equator() -> None:
    a, f = 6378137.0, 1 / 298.257223563
    assert mean_radius_m(90.0) == pytest.approx(a / (1 - f), rel=1e-12)
    assert mean_radius_m(0.0) == pytest.approx(a * (1 - f), rel=1e-12)


def test_enu_axes_are_orthonormal_and_point_east_north_up() -> None:
    rotation = ecef_R_enu(LON, LAT)
    assert np.abs(rotation.transpose(0, 2, 1) @ rotation - np.eye(3)).max() < 1e-12
    origin = geodetic_to_ecef(LON, LAT, 0.0)
    for axis, (azimuth, up) in enumerate([(90.0, 0.0), (0.0, 0.0), (0.0, 1.0)]):
        lon, lat = LON, LAT
        if axis < 2:
            lon, lat, _ = GEOD.fwd(LON, LAT, np.full(5000, azimuth), np.full(5000, 1.0))
        step = geodetic_to_ecef(lon, lat, up) - origin
        assert np.abs((step * rotation[:, :, axis]).sum(axis=1) - 1.0).max() < 1e-6


@settings(max_examples=draws(50), deadline=None)
@given(st.floats(-180, 180), st.floats(-89, 89), st.floats(-100, 5000), st.floats(0, 360), st.floats(0, 20_000))
def test_tangent_frame_inverts(lon: float, lat: float, height: float, azimuth: float, distance: float) -> None:
    frame = TangentFrame(lon, lat, height)
    to_lon, to_lat, _ = GEOD.fwd(lon, lat, azimuth, distance)
    world = frame.from_geodetic([to_lon], [to_lat], [height + 3.0])
    back = frame.to_geodetic(world)
    assert np.abs(frame.from_geodetic(*back) - world).max() < 2e-6
    assert abs(np.hypot(world[0, 0], world[0, 1]) - distance) < 1e-3 * distance + 1e-6
    assert np.abs(frame.from_geodetic(lon, lat, height)).max() < 1e-8


def test_directions_turn_between_tangent_frames() -> None:
    """North, 20 km east of the origin at 60 degrees, is turned by the convergence of the meridians."""
    frame = TangentFrame(11.0, 60.0)
    lon, lat, _ = GEOD.fwd(11.0, 60.0, 90.0, 20_000.0)
    turn = frame.world_R_enu(lon, lat)
    azimuth = np.degrees(np.arctan2(turn[0, 1], turn[1, 1]))
    assert azimuth == pytest.approx(-(lon - 11.0) * np.sin(np.radians(60.0)), abs=1e-3)


def test_utm_inverts_and_converges_as_a_step_north_does() -> None:
    lon, lat = RNG.uniform(-84, -78, 500), RNG.uniform(-70, 80, 500)
    for north in (True, False):
        east, northing = geodetic_to_utm(lon, lat, 17, north)
        back_lon, back_lat = utm_to_geodetic(east, northing, 17, north)
        assert np.abs(back_lon - lon).max() < 1e-9
        assert np.abs(back_lat - lat).max() < 1e-9
        up_lon, up_lat = utm_to_geodetic(east, northing + 1.0, 17, north)
        azimuth = np.radians(GEOD.inv(lon, lat, up_lon, up_lat)[0])
        assert np.abs(utm_convergence_rad(lon, lat, 17, north) - azimuth).max() < 1e-6
    with pytest.raises(UsageError, match="zone 61"):
        utm_to_geodetic([5e5], [0.0], 61, True)


def test_what_is_no_place_is_nan() -> None:
    lon, lat = utm_to_geodetic([np.nan, np.inf, 5e5], [0.0, 0.0, 4e6], 17, True)
    assert np.isnan(lon).tolist() == np.isnan(lat).tolist() == [True, True, False]
    assert np.isnan(ecef_to_geodetic([[np.nan, 0.0, 0.0]])[0]).all()


def test_circle_is_closed_and_round() -> None:
    ring = geodesic_circle(11.5, 48.1, 200.0, 64)
    assert ring.shape == (65, 2)
    assert (ring[0] == ring[-1]).all()
    distance = GEOD.inv(ring[:, 0], ring[:, 1], np.full(65, 11.5), np.full(65, 48.1))[2]
    assert np.abs(distance - 200.0).max() < 1e-6
    x, y = (ring[:-1] - [11.5, 48.1]).T
    assert np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) > 0, "counter-clockwise, as GeoJSON has it"
