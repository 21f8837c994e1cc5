"""The rows of ingest: poses in the scene's world, courses, and the frame of each image."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import RecordingError
from mirror.geometry.quaternions import heading_deg, matrix_from_quaternion
from mirror.ingest.passes import DrivePasses, PoseSlice
from mirror.ingest.tables import assign_frames, build_pose_table, course
from mirror.schema.documents import Roi
from tests.builders.folder import LAT, LON, SCENE, START_NS, locate_on_street, write_recording
from tests.ingest.passes import passes_of_folder

ROTATION = ("qw", "qx", "qy", "qz")
PLACE = ("tx_m", "ty_m", "tz_m")
LOCAL = Roi(scene_id="hall", frame="hall", x_m=0.0, y_m=0.0, radius_m=50.0)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> DrivePasses:
    return passes_of_folder(write_recording(tmp_path_factory.mktemp("drives"), "d0", cameras=()))


def made(first: np.ndarray, second: np.ndarray, **values: np.ndarray | None) -> PoseSlice:
    stamps = START_NS + 100_000_000 * np.arange(len(first), dtype=np.int64)
    nothing = {"height_m": None, "rotation": None, "sigma_m": None}
    return PoseSlice(stamps, first, second, **nothing | values, unknown=np.zeros(len(first), np.bool_))


def columns(table: pa.Table, names: tuple[str, ...]) -> np.ndarray:
    return np.column_stack([table.column(name).to_numpy() for name in names])


def unit_quaternions(count: int) -> np.ndarray:
    rotation = np.random.default_rng(1).normal(size=(count, 4))
    rotation *= np.where(rotation[:, :1] < 0, -1, 1)
    return rotation / np.linalg.norm(rotation, axis=1, keepdims=True)


def test_a_local_frame_is_the_world(drive: DrivePasses) -> None:
    x, y, z = np.random.default_rng(0).normal(0, 20, (3, 7))
    rotation = unit_quaternions(7)
    table = build_pose_table(made(x, y, height_m=z, rotation=rotation, sigma_m=np.full(7, 0.2)), LOCAL, drive)
    np.testing.assert_allclose(columns(table, ROTATION), rotation, atol=1e-15)
    np.testing.assert_array_equal(columns(table, PLACE), np.column_stack([x, y, z]))
    for name in ("longitude_deg", "latitude_deg", "height_m"):
        assert table.column(name).null_count == 7
    assert set(table.column("sigma_m").to_pylist()) == {0.2}
    assert set(table.column("orientation").to_pylist()) == {"recorded"}


def test_a_local_frame_without_heights_is_flat(drive: DrivePasses) -> None:
    table = build_pose_table(made(np.arange(4.0), np.zeros(4)), LOCAL, drive)
    assert table.column("tz_m").to_pylist() == [0.0] * 4
    assert set(table.column("orientation").to_pylist()) == {"course"}


@pytest.mark.parametrize("with_height", [True, False])
def test_the_world_is_east_north_up_at_the_centre(drive: DrivePasses, with_height: bool) -> None:
    """Against PROJ's topocentric conversion, which shares nothing with ours."""
    roi = SCENE.model_copy(update={"height_m": 500.0})
    offset = np.linspace(-50, 50, 5)
    lon, lat = locate_on_street(offset)
    lat = lat + 1e-4
    height = np.linspace(510, 530, 5)
    rotation = unit_quaternions(5)
    poses = made(lon, lat, rotation=rotation, height_m=height if with_height else None)
    table = build_pose_table(poses, roi, drive)
    steps = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84"
        f" +step +proj=topocentric +ellps=WGS84 +lon_0={LON} +lat_0={LAT} +h_0=500"
    )
    wanted = pyproj.Transformer.from_pipeline(steps).transform(lon, lat, height if with_height else np.full(5, 500.0))
    np.testing.assert_allclose(columns(table, PLACE), np.column_stack(wanted), atol=1e-6)
    assert (table.column("height_m").null_count == 0) == with_height
    np.testing.assert_array_equal(table.column("longitude_deg").to_numpy(), lon)
    # 50 m turn east and up by 8e-6 rad (and east by the convergence of meridians, as much again).
    world, local = matrix_from_quaternion(columns(table, ROTATION)), matrix_from_quaternion(rotation)
    np.testing.assert_allclose(world, local, atol=2e-5)
    assert np.abs(world[0] - local[0]).max() > 2e-6


def test_a_pose_that_is_none_is_named(drive: DrivePasses) -> None:
    rotation = unit_quaternions(3)
    rotation[1] = 0.0
    with pytest.raises(RecordingError) as caught:
        build_pose_table(made(np.arange(3.0), np.zeros(3), rotation=rotation), LOCAL, drive)
    assert str(START_NS) in str(caught.value)


def test_the_course_is_where_the_vehicle_drives() -> None:
    """Headings clockwise from north: a quarter circle from north to east, then standing."""
    angle = np.linspace(0, np.pi / 2, 60)
    x, y = 40 * (1 - np.cos(angle)), 40 * np.sin(angle)
    x, y = np.append(x, np.full(5, x[-1])), np.append(y, np.full(5, y[-1]))
    found = heading_deg(course(made(x, y), geodetic=False))
    np.testing.assert_allclose(found[:60], np.degrees(angle), atol=1.0)
    np.testing.assert_allclose(found[60:], found[59], atol=0.5)
    lon, lat = locate_on_street(np.linspace(0, 30, 31)[::-1])
    np.testing.assert_allclose(heading_deg(course(made(lon, lat), geodetic=True)), 270.0, atol=1e-3)


def test_a_step_counts_from_half_a_metre_on() -> None:
    """North by exactly half a metre counts; the step east after it, a little shorter, does not."""
    x, y = np.array([0.0, 0.0, 0.499]), np.array([0.0, 0.5, 0.5])
    np.testing.assert_allclose(heading_deg(course(made(x, y), geodetic=False)), 0.0, atol=1e-9)
    parked = course(made(np.zeros(3), np.array([0.0, 0.4, 0.0])), geodetic=False)
    np.testing.assert_allclose(heading_deg(parked), 0.0, atol=1e-9)
    assert course(made(np.empty(0), np.empty(0)), geodetic=False).shape == (0, 4)


STAMPS = st.lists(st.integers(0, 60), unique=True, max_size=12).map(lambda one: np.array(sorted(one), np.int64))


@settings(deadline=None)
@given(STAMPS, STAMPS)
def test_frames_against_every_pair(reference: np.ndarray, other: np.ndarray) -> None:
    found = assign_frames({"front": reference, "rear": other}, "front")
    if not len(reference):
        assert found == {"front": [], "rear": [None] * len(other)}
        return
    assert found["front"] == list(range(len(reference)))
    gaps = np.diff(reference) if len(reference) > 1 else np.diff(other)
    period = float(np.median(gaps)) if len(gaps) else 0.0
    for index, stamp in enumerate(other):
        away = np.abs(reference - stamp)
        nearest = int(np.argmin(away))
        backwards = int(np.argmin(np.abs(other - reference[nearest])))
        belongs = away[nearest] * 2 <= period and backwards == index
        assert found["rear"][index] == (nearest if belongs else None)
