"""Opening and querying: every filter against brute force, and that a query touches no more than it must."""

from __future__ import annotations

import json
import pickle
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import fsspec
import numpy as np
import pandas as pd
import pyarrow as pa
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mirror
from mirror.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.dataset.query.columns import ColumnCache
from mirror.dataset.query.filters import Circle
from mirror.errors import DatasetError, SchemaError, UsageError
from mirror.integrity import check
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_GLOBAL
from mirror.schema.tables import BOXES
from mirror.schema.version import DATASET_VERSION
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box
from tests.builders.index import segment_folder
from tests.draws import draws

GEOD = pyproj.Geod(ellps="WGS84")
LIGHT, WEATHER = ("day", "dusk", "night"), ("clear", "rain")


@pytest.fixture(scope="module")
def builder(tmp_path_factory: pytest.TempPathFactory) -> Builder:
    made = Builder(tmp_path_factory.mktemp("dataset"))
    made.scene("north", 25.47, 65.01)
    made.scene("south", 174.76, -36.85)
    made.scene("spare", 10.0, 50.0)
    for number in range(6):
        passes = [
            Pass(
                ("north", "south")[scene],
                EPOCH + (number * 10 + scene) * 100 * SECOND,
                frames=8 + number,
                heading_deg=60.0 * number + 7.0 * scene,
                offset_m=15.0 * number - 40.0,
                speed_mps=40.0,
                light=LIGHT[number % 3],
                weather=WEATHER[number % 2],
            )
            for scene in range(2)
        ]
        ids = made.drive(f"d{number}", passes, vehicle_id=f"v{number % 2}", refused=number % 2)
        if number < 2:
            rows = [box(passes[0].entry_ns + k * 100_000_000, "t") for k in range(8)]
            made.layer(ids[0], "boxes", "petr@1", BOXES, rows)
    build_index(made.root)
    return made


@pytest.fixture(scope="module")
def dataset(builder: Builder) -> Dataset:
    return mirror.open(builder.root)


@pytest.fixture(scope="module")
def tables(dataset: Dataset) -> dict[str, pd.DataFrame]:
    return {table.name: dataset.to_pandas(table.name) for table in (*INDEX_GLOBAL, *INDEX_BY_SCENE)}


def brute_force(tables: dict[str, pd.DataFrame], name: str, filters: dict[str, object]) -> pd.DataFrame:
    """The rows of a by-scene table that pass, by reading everything and asking PROJ for distances."""
    rows = tables[name].merge(
        tables["traversals"][["traversal_id", "drive_id", "vehicle_id", "light", "weather"]],
        on="traversal_id",
        suffixes=("", "_of_traversal"),
    )
    keep = np.ones(len(rows), bool)
    columns = {"scene": "scene_id", "traversal": "traversal_id", "drive": "drive_id", "vehicle": "vehicle_id"}
    for key, value in filters.items():
        if key == "time":
            start, end = value
            keep &= (rows["timestamp_ns"] >= start) & (rows["timestamp_ns"] < end)
        elif key == "within":
            lon, lat, radius = value
            n = len(rows)
            *_, distance = GEOD.inv(rows["longitude_deg"], rows["latitude_deg"], np.full(n, lon), np.full(n, lat))
            keep &= distance <= radius
        elif key != "camera" or name == "images":
            wanted = [value] if isinstance(value, str) else value
            keep &= rows[columns.get(key, key)].isin(wanted)
    return rows[keep]


choices = st.fixed_dictionaries(
    {},
    optional={
        "scene": st.sampled_from(["north", "south", ["north", "south"]]),
        "drive": st.lists(st.sampled_from([f"d{k}" for k in range(6)]), min_size=1, unique=True),
        "vehicle": st.sampled_from(["v0", "v1"]),
        "camera": st.lists(st.sampled_from(["front_wide", "front_left", "front_right"]), unique=True, min_size=1),
        "light": st.lists(st.sampled_from(LIGHT), unique=True, min_size=1),
        "weather": st.sampled_from(WEATHER),
        "time": st.tuples(st.integers(0, 6000), st.integers(1, 2000)).map(
            lambda pair: (EPOCH + pair[0] * SECOND, EPOCH + (pair[0] + pair[1]) * SECOND + 1)
        ),
        "within": st.tuples(
            st.sampled_from([(25.47, 65.01), (174.76, -36.85)]),
            st.floats(-3e-4, 3e-4),
            st.floats(-3e-4, 3e-4),
            st.floats(0.0, 120.0),
        ).map(lambda four: (four[0][0] + four[1], four[0][1] + four[2], four[3])),
    },
)


@settings(max_examples=draws(80), deadline=None)
@given(filters=choices, name=st.sampled_from(["images", "frames", "ego_poses"]))
def test_filters_agree_with_brute_force(
    dataset: Dataset, tables: dict[str, pd.DataFrame], filters: dict[str, object], name: str
) -> None:
    view = dataset.where(**filters)
    expected = brute_force(tables, name, filters)
    keys = ["traversal_id", *(["camera"] if name == "images" else []), "timestamp_ns"]
    found = view.to_pandas(name, keys)
    assert list(map(tuple, found.to_numpy())) == list(map(tuple, expected[keys].to_numpy()))
    assert view.count(name) == len(expected)


@settings(max_examples=draws(300), deadline=None)
@given(
    lon=st.floats(-180, 180),
    lat=st.floats(-90, 90),
    radius=st.one_of(st.floats(0, 300), st.floats(0, 20_000)),
    azimuth=st.floats(0, 360),
    beyond=st.floats(-1.0, 1.0),
    far=st.sampled_from([0.002, 1.0, 500.0, 4e5, 9e6]),
)
def test_circles_agree_with_the_exact_geodesic(
    lon: float, lat: float, radius: float, azimuth: float, beyond: float, far: float
) -> None:
    distance = max(0.0, radius + beyond * far)
    there_lon, there_lat, _ = GEOD.fwd(lon, lat, azimuth, distance)
    *_, exact = GEOD.inv(lon, lat, there_lon, there_lat)
    circle = Circle(lon, lat, radius)
    lons, lats = np.array([there_lon]), np.array([there_lat])
    if abs(exact - radius) > 1e-3:
        assert circle.contains(lons, lats)[0] == (exact <= radius)
    if exact <= radius - 1e-6:
        assert circle.touches(lons, lons, lats, lats)[0]
        assert circle.touches(lons - 0.1, lons + 0.1, lats - 0.1, lats + 0.1)[0]
    west, east = np.sort(np.column_stack([lons, np.full(1, lon)]), axis=1)[0]
    south, north = np.sort(np.column_stack([lats, np.full(1, lat)]), axis=1)[0]
    if circle.covers(*(np.array([edge]) for edge in (west, east, south, north)))[0]:
        grid = np.meshgrid(np.linspace(west, east, 5), np.linspace(south, north, 5))
        *_, farthest = GEOD.inv(*(axis.ravel() for axis in grid), np.full(25, lon), np.full(25, lat))
        assert np.max(farthest) <= radius


def test_a_circle_touches_a_box_at_its_northernmost_place() -> None:
    """At the equator the curvature is the smallest, so that the bound of the latitude has only its own margin."""
    circle = Circle(10.0, 0.0, 200.0)
    north = np.array([GEOD.fwd(10.0, 0.0, 0.0, 200.0)[1]])
    assert circle.touches(np.array([9.9]), np.array([10.1]), north, north + 1.0)[0]
    assert circle.touches(np.array([9.9]), np.array([10.1]), -north - 1.0, -north)[0]
    beyond = np.array([GEOD.fwd(10.0, 0.0, 0.0, 200.1)[1]])
    assert not circle.touches(np.array([9.9]), np.array([10.1]), beyond, beyond + 1.0)[0]


def test_the_edge_of_a_circle_belongs_to_it() -> None:
    circle = Circle(10.0, 50.0, 0.0)
    assert circle.contains(np.array([10.0, np.nan]), np.array([50.0, 50.0])).tolist() == [True, False]
    assert not circle.contains(np.empty(0), np.empty(0)).size


@pytest.mark.parametrize("place", [(180.0, 50.0), (-180.0, 50.0), (10.0, 90.0), (10.0, -90.0)])
def test_a_circle_is_round_a_place_up_to_the_ends_of_the_globe(place: tuple[float, float]) -> None:
    near, far = np.array(place)[:, None], np.array([[20.0], [0.0]])
    circle = Circle(*place, 1.0)
    assert circle.contains(*near).tolist() == [True] and circle.contains(*far).tolist() == [False]
    with pytest.raises(UsageError, match="is no place"):
        Circle(*(np.nextafter(value, 2.0 * value) if abs(value) in (90.0, 180.0) else value for value in place), 1.0)


def test_traversals_pass_a_circle_by_their_driven_line(dataset: Dataset) -> None:
    traversals = dataset.where(scene="north").table("traversals", ["traversal_id", "closest_m"]).to_pylist()
    for radius in (1.0, 12.0, 26.0, 36.0):
        # The lines pass the centre at exactly closest_m, between two poses.
        expected = [row["traversal_id"] for row in traversals if row["closest_m"] <= radius]
        view = dataset.where(within=(25.47, 65.01, radius))
        assert view.traversals() == expected
        assert view.scenes() == (["north"] if expected else [])
        assert view.count("calibrations") == 3 * len(expected)


def test_views_are_intersected(dataset: Dataset) -> None:
    first = dataset.where(drive=["d1", "d2"], time=(EPOCH, EPOCH + 2500 * SECOND))
    both = first.where(drive=["d2", "d3"], time=(EPOCH + 1000 * SECOND, EPOCH + 9999 * SECOND))
    assert both.drives() == ["d2"]
    assert both.filters.time == (EPOCH + 1000 * SECOND, EPOCH + 2500 * SECOND)
    assert first.drives() == ["d1", "d2"]
    one = dataset.where(within=(25.47, 65.01, 30.0))
    two = one.where(within=(25.4705, 65.01, 30.0))
    assert 0 < two.count("images") < one.count("images")


def test_ids_cameras_and_ledger(dataset: Dataset) -> None:
    assert dataset.scenes() == ["north", "south", "spare"]
    assert dataset.where(scene="spare").scenes() == ["spare"]
    assert dataset.where(light="night").scenes() == ["north", "south"]
    assert len(dataset.traversals()) == 12
    assert dataset.cameras() == ["front_wide", "front_left", "front_right"]
    assert dataset.where(camera="front_left").cameras() == ["front_left"]
    assert dataset.passes().num_rows == 15
    assert dataset.where(drive="d1").count("passes") == 3
    assert dataset.where(drive="d1", vehicle="v1").count("passes") == 2
    assert dataset.where(time=(EPOCH, EPOCH + 50 * SECOND)).count("passes") == 1
    assert dataset.where(scene="north").count("row_groups") == 6 * 4 + 2
    assert "12 traversals" in repr(dataset)


def test_empty_intersections_give_empty_tables_of_the_right_type(dataset: Dataset) -> None:
    nothing = dataset.where(drive="d1").where(drive="d2")
    for table in (*INDEX_GLOBAL, *INDEX_BY_SCENE):
        found = nothing.table(table.name)
        assert found.num_rows == 0 and found.schema.equals(table.schema)
    assert nothing.where(camera=[]).count("images") == 0


def test_columns_come_in_the_asked_order(dataset: Dataset) -> None:
    assert dataset.table("images", ["uri", "scene_id"]).column_names == ["uri", "scene_id"]
    assert dataset.table("images", []).num_columns == 0


@pytest.mark.parametrize(
    ("filters", "message"),
    [
        ({"camera": "front_wid"}, "did you mean 'front_wide'"),
        ({"scene": "nroth"}, "did you mean 'north'"),
        ({"drive": ["d1", "x"]}, "unknown drive 'x'"),
        ({"vehicle": "v9"}, "one of v0, v1"),
        ({"traversal": "none"}, "unknown traversal"),
        ({"light": "dark"}, "one of day, dusk, night"),
        ({"weather": "sunny"}, "unknown weather"),
        ({"time": (5, 5)}, "start before end"),
        ({"time": (0.5, 7)}, "whole numbers"),
        ({"time": ("a", "b")}, "('a', 'b'); expected (start_ns, end_ns)"),
        ({"time": "ab"}, "whole numbers"),
        ({"time": (float("nan"), 7)}, "whole numbers"),
        ({"time": (1, 2, 3)}, "(start_ns, end_ns)"),
        ({"time": (None, 7)}, "(start_ns, end_ns)"),
        ({"time": 7}, "(start_ns, end_ns)"),
        ({"within": (65.01, 125.47, 10)}, "swap longitude and latitude"),
        ({"within": (25.0, 65.0, -1)}, "radius -1"),
        ({"within": (25.0, 65.0, float("nan"))}, "radius nan"),
        ({"within": (25.0, 65.0, 1e6)}, "0 to 20000 m"),
        ({"within": (25.0, 65.0)}, "radius_m"),
        ({"within": (0.0, 0.0, 1.0, "map")}, "unknown frame 'map'"),
        ({"role": "train"}, "role without split"),
        ({"split": "../dataset"}, "cannot be the name of a split; expected letters, digits, _ and -"),
        ({"split": "a/b"}, "cannot be the name of a split"),
        ({"split": ""}, "cannot be the name of a split"),
    ],
)
def test_unknown_values_are_refused_with_what_is_known(
    dataset: Dataset, filters: dict[str, object], message: str
) -> None:
    with pytest.raises(UsageError) as caught:
        dataset.where(**filters)
    assert message in str(caught.value)


def test_unknown_tables_and_columns_are_refused(dataset: Dataset) -> None:
    with pytest.raises(UsageError, match="did you mean 'images'"):
        dataset.table("image")
    with pytest.raises(UsageError, match="did you mean 'camera'"):
        dataset.table("images", ["camra"])
    with pytest.raises(UsageError, match="unknown table"):
        dataset.count("nonsense")


def test_a_query_reads_only_the_row_groups_and_columns_it_needs(
    builder: Builder, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: list[tuple[str, int, tuple[str, ...]]] = []
    plain = ColumnCache.decode

    def counting(self: ColumnCache, path: str, row_group: int, names: Sequence[str]) -> dict[str, pa.Array]:
        decoded.append((path, row_group, tuple(names)))
        return plain(self, path, row_group, names)

    monkeypatch.setattr(ColumnCache, "decode", counting)
    dataset = mirror.open(builder.root)

    def by_scene() -> list[tuple[str, int, tuple[str, ...]]]:
        return [entry for entry in decoded if entry[0].count("/") == 3]

    north = f"index/{segment_folder(builder.root).name}/images/north.parquet"
    dataset.count("images")
    assert by_scene() == []
    night = dataset.where(light="night", scene="north")
    night.table("images", ["uri"])
    assert by_scene() == [(north, 2, ("uri",)), (north, 5, ("uri",))]
    decoded.clear()
    night.table("images", ["uri"])
    assert by_scene() == []
    dataset.where(time=(EPOCH, EPOCH + 90 * SECOND)).count("images")
    assert by_scene() == []
    dataset.where(within=(0.0, 0.0, 1000.0)).table("images")
    assert by_scene() == []
    dataset.where(within=(25.47, 65.01, 1e4)).count("images")
    assert by_scene() == []
    dataset.where(within=(25.47, 65.01, 15.0)).table("images", ["timestamp_ns"])
    assert {entry[0] for entry in by_scene()} == {north}
    assert {name for entry in by_scene() for name in entry[2]} == {"longitude_deg", "latitude_deg", "timestamp_ns"}


def test_the_cache_holds_no_more_than_its_limit(builder: Builder) -> None:
    dataset = mirror.open(builder.root)
    cache = dataset.catalog.columns
    cache.limit_bytes = 20_000
    rng = np.random.default_rng(0)
    for _ in range(40):
        column = str(rng.choice(dataset.table("images", ["camera"]).column_names))
        dataset.where(drive=f"d{rng.integers(6)}").table("images", [column, "uri", "timestamp_ns"])
        assert cache.held_bytes <= 20_000
    assert cache.held_bytes == sum(column.nbytes for column in cache.columns.values())


def test_a_first_query_imports_nothing_heavy(builder: Builder) -> None:
    code = f"""
import sys
import pyarrow
import mirror.dataset.layout
assert "pyarrow.dataset" not in sys.modules
import mirror
dataset = mirror.open({str(builder.root)!r})
view = dataset.where(within=(25.47, 65.01, 50.0), camera="front_left", light="day", time=(0, 2**62))
assert view.table("images", ["scene_id", "traversal_id", "camera", "timestamp_ns", "uri"]).num_rows > 0
assert len(view.frames()) > 0 and view.traversals() and view.cameras()
heavy = {{"pandas", "pyarrow.dataset", "fsspec", "cv2", "numba", "pyproj", "shapely", "torch", "av"}}
if int(pyarrow.__version__.partition(".")[0]) < 26:
    # It imports pandas for every list of which it makes an array.
    heavy.remove("pandas")
print(sorted(heavy & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_view_can_be_pickled(builder: Builder, dataset: Dataset) -> None:
    view = dataset.where(drive="d1", within=(25.47, 65.01, 50.0)).with_layers(boxes="petr@1")
    again = pickle.loads(pickle.dumps(view))
    assert again.filters == view.filters and again.layers == view.layers
    assert again.table("images").equals(view.table("images"))


def test_a_pickled_view_refuses_another_index(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    builder.drive("d1", [Pass("a")])
    build_index(tmp_path)
    pickled = pickle.dumps(mirror.open(tmp_path))
    builder.drive("d2", [Pass("a", EPOCH + 50 * SECOND)])
    build_index(tmp_path)
    # The snapshot that it reads is still there.
    assert pickle.loads(pickled).drives() == ["d1"]
    shutil.rmtree(tmp_path / "index")
    build_index(tmp_path)
    with pytest.raises(DatasetError, match="has changed since this view was made"):
        pickle.loads(pickled)


def _two_drives(root: Path) -> Builder:
    builder = Builder(root)
    builder.scene("a")
    for number in (1, 2):
        builder.drive(f"d{number}", [Pass("a", EPOCH + number * 50 * SECOND)])
    build_index(root)
    return builder


@pytest.mark.parametrize("seen", ["nothing", "row groups", "a table"])
def test_an_open_dataset_never_mixes_two_indexes(tmp_path: Path, seen: str) -> None:
    builder = _two_drives(tmp_path)
    dataset = mirror.open(tmp_path)
    before = mirror.open(tmp_path).where(drive="d2").table("images").to_pylist()
    if seen != "nothing":
        view = dataset.where(drive="d2")
        assert view.count("images") == len(before)
        # A file that is open stays the one that it was.
        if seen == "a table":
            assert view.table("images").to_pylist() == before
    poses = mirror.open(tmp_path).where(drive="d2").table("ego_poses").to_pylist()
    builder.drive("d0", [Pass("a", EPOCH, frames=3)])
    build_index(tmp_path)
    # It goes on reading the index that it was opened on.
    assert dataset.where(drive="d2").table("images").to_pylist() == before
    assert dataset.where(drive="d2").table("ego_poses").to_pylist() == poses
    assert len(dataset.traversals()) == 2
    assert len(pickle.loads(pickle.dumps(dataset)).traversals()) == 2
    again = mirror.open(tmp_path)
    assert again.traversals()[0].startswith("a.d0.") and len(again.traversals()) == 3
    assert again.where(drive="d2").table("images").to_pylist() == before
    # An earlier snapshot is there, whoever reads it.
    assert mirror.open(tmp_path, at=1).where(drive="d2").table("images").to_pylist() == before
    assert not (tmp_path / ".superseded").exists()


def test_a_file_of_equal_size_with_other_bytes_is_refused(tmp_path: Path) -> None:
    _two_drives(tmp_path)
    path = segment_folder(tmp_path) / "images" / "a.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 1
    path.write_bytes(data)
    with pytest.raises(DatasetError, match="has changed"):
        mirror.open(tmp_path).table("images")


def test_a_file_of_another_size_in_an_archive_is_refused(tmp_path: Path) -> None:
    """Files that are not local are not hashed; their size must be that of the manifest."""
    _two_drives(tmp_path / "dataset")
    with zipfile.ZipFile(tmp_path / "dataset.zip", "w") as archive:
        for path in (tmp_path / "dataset").rglob("*"):
            if path.is_file():
                more = b"\0" if path.parent.name == "images" and path.name == "a.parquet" else b""
                archive.writestr(str(path.relative_to(tmp_path / "dataset")), more + path.read_bytes())
    other = mirror.open(f"zip::{tmp_path}/dataset.zip")
    assert other.table("ego_poses").num_rows
    with pytest.raises(DatasetError, match="has changed"):
        other.table("images")


def test_files_that_were_closed_are_held_against_the_manifest_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mirror.dataset.query.files.MAX_OPEN_FILES", 1)
    builder = _two_drives(tmp_path)
    dataset = mirror.open(tmp_path)
    folder = f"index/{segment_folder(tmp_path).name}"
    for name in ("images", "ego_poses", "images", "frames"):
        assert dataset.table(name).num_rows == dataset.count(name) > 0
    builder.drive("d0", [Pass("a", EPOCH, frames=3)])
    build_index(tmp_path)
    # Opened again, it is still the file that the manifest named.
    uris = dataset.catalog.columns.decode(f"{folder}/images/a.parquet", 0, ["uri"])["uri"].to_pylist()
    assert uris and all("d1" in uri for uri in uris)
    changed = tmp_path / folder / "images/a.parquet"
    changed.write_bytes(changed.read_bytes()[:-1] + b"x")
    dataset.catalog.columns.decode(f"{folder}/frames/a.parquet", 0, ["timestamp_ns"])
    with pytest.raises(DatasetError, match="has changed"):
        dataset.catalog.columns.decode(f"{folder}/images/a.parquet", 0, ["uri"])


@pytest.mark.parametrize("kind", ["memory", "zip", "file"])
def test_any_file_system_gives_the_same(builder: Builder, dataset: Dataset, tmp_path: Path, kind: str) -> None:
    files = [path for path in builder.root.rglob("*") if path.is_file()]
    if kind == "memory":
        url = f"memory://{builder.root.name}"
        for path in files:
            fsspec.filesystem("memory").pipe(
                f"/{builder.root.name}/{path.relative_to(builder.root)}", path.read_bytes()
            )
    elif kind == "zip":
        with zipfile.ZipFile(tmp_path / "dataset.zip", "w") as archive:
            for path in files:
                archive.write(path, path.relative_to(builder.root))
        url = f"zip::{tmp_path}/dataset.zip"
    else:
        url = f"file://{builder.root}"
    other = mirror.open(url)
    filters = {"within": (25.47, 65.01, 60.0), "light": ["day", "night"]}
    assert other.where(**filters).table("images").equals(dataset.where(**filters).table("images"))
    assert len(other.frames()) == len(dataset.frames())
    assert pickle.loads(pickle.dumps(other)).traversals() == dataset.traversals()
    with pytest.raises(UsageError, match="read only"):
        _ = other.layout


def test_local_frames_are_asked_by_their_name(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a", frame="map", x_m=0.0, y_m=0.0)
    builder.scene("b", frame="other", x_m=0.0, y_m=0.0)
    builder.scene("c", 0.0, 0.0)
    for drive_id, scene_id in (("d1", "a"), ("d2", "b"), ("d3", "c")):
        builder.drive(drive_id, [Pass(scene_id, frames=40, speed_mps=40.0)])
    build_index(tmp_path)
    dataset = mirror.open(tmp_path)
    view = dataset.where(within=(0.0, 0.0, 30.0, "map"))
    assert view.scenes() == ["a"] and view.drives() == ["d1"]
    images = dataset.where(scene="a").to_pandas("images")
    assert view.count("images") == int((np.hypot(images["x_m"], images["y_m"]) <= 30.0).sum()) > 0
    assert view.count("ego_poses") > 0 and view.count("calibrations") == 3
    assert dataset.where(within=(0.0, 0.0, 30.0)).drives() == ["d3"]
    assert dataset.where(within=(0.0, 0.0, 30.0)).count("images") == view.count("images")
    assert dataset.where(within=(500.0, 0.0, 30.0, "map")).traversals() == []


def test_splits_filter_by_role(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    ids = [builder.drive(f"d{k}", [Pass("a", EPOCH + k * 50 * SECOND)])[0] for k in range(4)]
    build_index(tmp_path)
    split = {
        "schema_version": "1.0.0",
        "name": "s",
        "parameters": {"method": "by-scene"},
        "seed": 0,
        "scenes": None,
        "dataset_hash": "0",
        "manifests": {},
        "assignments": dict(zip(ids, ("train", "train", "held_out", "unused"))),
    }
    (tmp_path / "splits").mkdir()
    (tmp_path / "splits" / "s.json").write_text(json.dumps(split))
    dataset = mirror.open(tmp_path)
    assert dataset.where(split="s", role="train").traversals() == ids[:2]
    assert dataset.where(split="s").traversals() == ids[:3]
    assert dataset.where(split="s", role=["held_out", "val"]).traversals() == ids[2:3]
    assert dataset.roles("s") == ["held_out", "train"]
    assert dataset.where(traversal=ids[2]).roles("s") == ["held_out"]
    with pytest.raises(UsageError, match="did you mean 'train'"):
        dataset.where(split="s", role="trian")
    for role in ("test", ["test", "val"]):
        with pytest.raises(UsageError, match=r"'test'.*held_out, train"):
            dataset.where(split="s", role=role)
    with pytest.raises(DatasetError, match=r"expected one of s\."):
        dataset.where(split="t", role="train")


def stale(root: Path) -> str:
    """Return what the check says of an index that is not up to date."""
    return " ".join(finding.message for _, finding in check(root, only=["IDX002"]).findings)


class TestOpening:
    def test_what_is_no_dataset(self, tmp_path: Path) -> None:
        with pytest.raises(DatasetError, match=r"dataset\.json is missing"):
            mirror.open(tmp_path)
        with pytest.raises(DatasetError, match="the folder does not exist"):
            mirror.open(tmp_path / "nowhere")
        with pytest.raises(DatasetError, match=r"dataset\.json is missing"):
            mirror.open("memory://nowhere")

    def test_what_has_no_index(self, tmp_path: Path) -> None:
        Builder(tmp_path)
        with pytest.raises(DatasetError, match="mirror index"):
            mirror.open(tmp_path)

    def test_what_is_of_another_version(self, tmp_path: Path) -> None:
        builder = Builder(tmp_path)
        build_index(tmp_path)
        text = builder.layout.document.read_text()
        builder.layout.document.write_text(text.replace(DATASET_VERSION, "9.0.0"))
        with pytest.raises(SchemaError, match="upgrade the toolkit"):
            mirror.open(tmp_path)

    def test_a_stale_index(self, tmp_path: Path) -> None:
        builder = Builder(tmp_path)
        builder.scene("a")
        (traversal,) = builder.drive("d", [Pass("a")])
        build_index(tmp_path)
        mirror.open(tmp_path)
        layer = builder.layer(traversal, "boxes", "petr@1", BOXES, [box(EPOCH, "t")])
        # It is opened as of its snapshot; the check finds what is not in it.
        assert mirror.open(tmp_path).count("boxes") == 0
        assert "stale: drive:d changed" in stale(tmp_path)
        (layer / "manifest.json").unlink()
        # Without its manifest the layer does not exist.
        assert stale(tmp_path) == ""
        builder.scene("a", radius_m=150.0)
        assert "stale: scene:a changed" in stale(tmp_path)

    @pytest.mark.parametrize("keep", [0, 100, -20])
    def test_a_truncated_table(self, tmp_path: Path, keep: int) -> None:
        builder = Builder(tmp_path)
        builder.scene("a")
        builder.drive("d", [Pass("a")])
        build_index(tmp_path)
        path = segment_folder(tmp_path) / "images" / "a.parquet"
        path.write_bytes(path.read_bytes()[:keep])
        with pytest.raises(DatasetError, match=r"images/a\.parquet.*mirror index"):
            mirror.open(tmp_path).table("images")
        path.unlink()
        with pytest.raises(DatasetError, match=r"images/a\.parquet"):
            mirror.open(tmp_path).table("images")
