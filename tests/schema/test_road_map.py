"""Road maps as GeoParquet: writing and reading, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely

from mirror.errors import DatasetError, SchemaError, UsageError
from mirror.schema.road_map import (
    MapArea,
    MapCrossing,
    MapLane,
    MapSignal,
    RoadMap,
    encode_road_map,
    read_road_map,
    write_road_map,
)


def lane(lane_id: str, begin: float, end: float, **more: object) -> MapLane:
    line = np.column_stack([np.linspace(begin, end, 5), np.zeros(5), np.linspace(0.0, 0.5, 5)])
    return MapLane(lane_id, more.pop("kind", "drive"), line, np.linspace(3.0, 3.5, 5), **more)


def small_map(**more: object) -> RoadMap:
    square = np.array([[-5.0, -5.0], [45.0, -5.0], [45.0, 5.0], [-5.0, 5.0]])
    hole = 0.1 * square[::-1] + 1.0
    lanes = (
        lane("a", 0.0, 20.0, successors=("b",), speed_limit_mps=13.9, stop_m=18.0, signal="s", yields_to=("b",)),
        lane("b", 20.0, 40.0, predecessors=("a",), left="a", kind="turn"),
    )
    return RoadMap(
        scene_id="street",
        frame=more.pop("frame", None),
        fitted=True,
        margin_m=0.5,
        lanes={one.lane_id: one for one in lanes},
        drivable=(MapArea("all", (square, hole)),),
        crossings=(MapCrossing("zebra", square[:3]),),
        signals={"s": MapSignal("s", (("green", 20.0), ("amber", 3.0), ("red", 7.0)), 4.0)},
        **more,
    )


def test_a_written_map_reads_back(tmp_path: Path) -> None:
    road_map = small_map(frame="site")
    write_road_map(tmp_path / "map.parquet", road_map)
    again = read_road_map(tmp_path / "map.parquet")
    assert encode_road_map(again) == encode_road_map(road_map)
    assert (again.scene_id, again.frame, again.fitted, again.margin_m) == ("street", "site", True, 0.5)
    for name, one in road_map.lanes.items():
        np.testing.assert_array_equal(again.lanes[name].center_m, one.center_m)
        np.testing.assert_array_equal(again.lanes[name].width_m, one.width_m)
    for ring, other in zip(again.drivable_rings, road_map.drivable_rings, strict=True):
        np.testing.assert_array_equal(ring, other)
    assert again.signals == road_map.signals
    assert again.signal_lanes("s")[0].lane_id == "a"


def test_any_geoparquet_reader_can_read_it(tmp_path: Path) -> None:
    write_road_map(tmp_path / "map.parquet", small_map())
    table = pq.read_table(tmp_path / "map.parquet")
    geo = json.loads(table.schema.metadata[b"geo"])
    column = geo["columns"][geo["primary_column"]]
    assert (geo["version"], column["encoding"], column["crs"]) == ("1.1.0", "WKB", None)
    shapes = [shapely.from_wkb(data) for data in table["geometry"].to_pylist() if data is not None]
    found = {f"{shape.geom_type}{' Z' if shape.has_z else ''}" for shape in shapes}
    assert found == set(column["geometry_types"])
    bounds = shapely.total_bounds(shapely.union_all([shapely.force_2d(shape) for shape in shapes]))
    np.testing.assert_allclose(column["bbox"], bounds)
    for row in table.to_pylist():
        if row["geometry"] is not None:
            assert tuple(row["bbox"].values()) == shapely.from_wkb(row["geometry"]).bounds


def test_a_signal_repeats_its_phases() -> None:
    signal = MapSignal("s", (("green", 20.0), ("amber", 3.0), ("red", 7.0)), 4.0)
    times = {4.0: "green", 23.9: "green", 24.0: "amber", 27.0: "red", 3.9: "red", 34.0: "green", -1e4 + 4: "amber"}
    # -10,000 s is 10 s before a multiple of the cycle of 30 s: 20 s into it.
    assert {time: signal.state_at(time) for time in times} == times
    assert MapSignal("s").state_at(3.0) is None


def test_the_outline_of_a_lane_has_its_width() -> None:
    outline = lane("a", 0.0, 20.0).outline_m
    assert shapely.Polygon(outline).area == pytest.approx(20.0 * 3.25)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: lane("a", 0.0, 0.0), "length 0"),
        (lambda: lane("a", 0.0, np.nan), "not finite"),
        (lambda: replace(lane("a", 0.0, 1.0), width_m=np.zeros(5)), "not positive"),
        (lambda: replace(lane("a", 0.0, 1.0), width_m=np.ones(4)), "widths of shape"),
        (lambda: replace(lane("a", 0.0, 1.0), center_m=np.zeros((1, 3))), "middle line of shape"),
        (lambda: replace(lane("a", 0.0, 1.0), kind="fly"), "kind 'fly'"),
        (lambda: MapArea("x", ()), "no outline"),
        (lambda: MapArea("x", (np.zeros((2, 2)),)), "a ring of shape"),
        (lambda: MapCrossing("x", np.full((3, 2), np.inf)), "a ring of shape"),
        (lambda: MapSignal("x", (("blue", 3.0),)), "phase 'blue'"),
        (lambda: MapSignal("x", (("red", 0.0),)), "phase 'red'"),
        (lambda: RoadMap("s", None, False, {"a": lane("a", 0.0, 1.0, left="b")}, ()), "no lane 'b'"),
        (lambda: RoadMap("s", None, False, {"a": lane("a", 0.0, 1.0, signal="b")}, ()), "no signal 'b'"),
    ],
)
def test_bad_features_are_refused(make, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        make()


def test_bad_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "map.parquet"
    with pytest.raises(DatasetError, match="missing"):
        read_road_map(path)
    path.write_bytes(b"PAR1")
    with pytest.raises(SchemaError, match="cannot be read"):
        read_road_map(path)
    data = pq.read_table(_written(tmp_path))
    pq.write_table(data.replace_schema_metadata(None), path)
    with pytest.raises(SchemaError, match="mirror_road_map"):
        read_road_map(path)
    for geometry, message in (
        (b"nonsense", "not WKB"),
        (None, "no geometry"),
        (shapely.to_wkb(shapely.Point(0, 0)), "a Point"),
    ):
        rows = data.to_pylist()
        rows[0]["geometry"] = geometry
        pq.write_table(type(data).from_pylist(rows, schema=data.schema), path)
        with pytest.raises(SchemaError, match=message):
            read_road_map(path)
    rows = data.to_pylist()
    rows[0]["successors"] = ["nowhere"]
    pq.write_table(type(data).from_pylist(rows, schema=data.schema), path)
    with pytest.raises(SchemaError, match="no lane 'nowhere'"):
        read_road_map(path)


def _written(folder: Path) -> Path:
    write_road_map(folder / "good.parquet", small_map())
    return folder / "good.parquet"
