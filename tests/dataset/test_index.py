"""The derived index: what it holds, that it is a pure function of the rest, and that only what changed is redone."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyproj
import pytest
import shapely

import mirror
from mirror.dataset.index import build_index
from mirror.errors import DatasetError, SchemaError
from mirror.geometry.geodesy import TangentFrame
from mirror.schema.files import read_table, write_table
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_GLOBAL
from mirror.schema.tables import BOXES, IMAGES, MASKS
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box, mask_row, write_reconstruction
from tests.builders.index import segment_folder, segment_names, tables_of
from tests.interruption import interrupt_before

GEOD = pyproj.Geod(ellps="WGS84")


def two_scenes(root: Path, order: tuple[str, ...] = ("d1", "d2", "d3")) -> Builder:
    builder = Builder(root)
    builder.scene("a", city="Toronto")
    builder.scene("b", 2.35, 48.85, scene_type="urban")
    drives = {
        "d1": [Pass("a"), Pass("b", EPOCH + 100 * SECOND, heading_deg=200.0)],
        "d2": [Pass("a", EPOCH + 200 * SECOND, light="night", dropped=frozenset({("front_left", 2)}))],
        "d3": [Pass("b", EPOCH + 300 * SECOND, weather="rain")],
    }
    for drive_id in order:
        builder.drive(drive_id, drives[drive_id], vehicle_id=f"v-{drive_id}", refused=1)
    return builder


def index_bytes(root: Path) -> dict[str, bytes]:
    """The files of the only segment of the newest snapshot."""
    index = segment_folder(root)
    return {str(path.relative_to(index)): path.read_bytes() for path in sorted(index.rglob("*")) if path.is_file()}


def test_every_table_follows_its_specification(tmp_path: Path) -> None:
    builder = two_scenes(tmp_path)
    layer = builder.drive("d4", [Pass("a", EPOCH + 400 * SECOND)])[0]
    builder.layer(layer, "boxes", "petr@1", BOXES, [box(EPOCH + 400 * SECOND, "t")])
    builder.layer(layer, "masks", "sam@1", MASKS, [mask_row("front_wide", EPOCH + 400 * SECOND, "x.png")])
    write_reconstruction(builder, layer, "front_wide", EPOCH + 400 * SECOND)
    report = build_index(tmp_path)
    assert report.scenes_written == ("a", "b")
    files = index_bytes(tmp_path)
    for table in INDEX_GLOBAL:
        data = read_table(tmp_path / table.place.replace("<segment>", segment_folder(tmp_path).name), table)
        assert data.num_rows == report.rows.get(table.name, data.num_rows)
    for table in INDEX_BY_SCENE:
        scenes = [name for name in files if name.startswith(f"{table.name}/")]
        rows = sum(read_table(segment_folder(tmp_path) / name, table).num_rows for name in scenes)
        assert rows == report.rows[table.name] > 0
        for name in scenes:
            file = pq.ParquetFile(segment_folder(tmp_path) / name)
            groups = [
                file.read_row_group(k, ["traversal_id"]).column(0).unique().to_pylist()
                for k in range(file.num_row_groups)
            ]
            assert all(len(own) == 1 for own in groups)
            assert groups == sorted(groups)
            data = file.read().to_pylist()
            keys = [tuple("" if row[key] is None else row[key] for key in table.sorted_by) for row in data]
            assert keys == sorted(keys)


def test_positions_of_images_are_the_exact_ones(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    roi = builder.scene("a", height_m=120.0)
    one = Pass("a", frames=50, heading_deg=77.0, offset_m=12.5, speed_mps=17.0)
    builder.drive("d", [one])
    build_index(tmp_path)
    images = mirror.open(tmp_path).to_pandas("images")
    truth = one.position(images["timestamp_ns"].to_numpy())
    assert np.abs(images[["x_m", "y_m"]].to_numpy() - truth[:, :2]).max() < 1e-6
    lon, lat, _ = TangentFrame(roi.longitude_deg, roi.latitude_deg, roi.height_m).to_geodetic(truth)
    *_, distance = GEOD.inv(lon, lat, images["longitude_deg"].to_numpy(), images["latitude_deg"].to_numpy())
    assert distance.max() < 1e-6


def test_frames_count_the_cameras_that_are_there(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    builder.drive("d", [Pass("a", frames=3, dropped=frozenset({("front_left", 1), ("front_wide", 2)}))])
    build_index(tmp_path)
    frames = mirror.open(tmp_path).table("frames").to_pydict()
    assert frames["frame_index"] == [0, 1]
    assert frames["images"] == [3, 2]
    assert frames["timestamp_ns"] == [EPOCH, EPOCH + 100_000_000]


def test_a_huge_frame_index_takes_no_more_memory_than_its_rows(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    (traversal,) = builder.drive("d", [Pass("a", frames=3)])
    file = builder.layout.recorded(traversal) / "images.parquet"
    images = read_table(file, IMAGES)
    index = [2**31 - 1 if number == 2 else number for number in images.column("frame_index").to_pylist()]
    column = images.column_names.index("frame_index")
    write_table(
        file, images.set_column(column, IMAGES.schema.field("frame_index"), [pa.array(index, pa.int32())]), IMAGES
    )
    tracemalloc.start()
    build_index(tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    frames = mirror.open(tmp_path).table("frames").to_pydict()
    assert frames["frame_index"] == [0, 1, 2**31 - 1]
    assert frames["images"] == [3, 3, 3]
    assert peak < 64 * 2**20


def test_bytes_do_not_depend_on_the_order_of_ingest_or_on_history(tmp_path: Path) -> None:
    two_scenes(tmp_path / "one")
    build_index(tmp_path / "one")
    two_scenes(tmp_path / "two", ("d3", "d1", "d2"))
    build_index(tmp_path / "two")
    grown = two_scenes(tmp_path / "three", ("d2",))
    build_index(tmp_path / "three")
    two_scenes(tmp_path / "three")
    build_index(grown.root)
    build_index(grown.root, compact=True)
    expected = index_bytes(tmp_path / "one")
    assert index_bytes(tmp_path / "two") == expected
    assert index_bytes(tmp_path / "three") == expected
    build_index(tmp_path / "one", force=True)
    assert index_bytes(tmp_path / "one") == expected


def test_only_changed_scenes_are_derived(tmp_path: Path) -> None:
    builder = two_scenes(tmp_path)
    build_index(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "index").rglob("*") if path.is_file()}
    again = build_index(tmp_path)
    assert again.scenes_written == () and again.scenes_kept == ("a", "b")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "index").rglob("*") if path.is_file()} == before

    seen: list[tuple[int, int]] = []
    builder.drive("d4", [Pass("b", EPOCH + 900 * SECOND)])
    report = build_index(tmp_path, progress=lambda done, total: seen.append((done, total)))
    assert report.scenes_written == ("b",) and report.scenes_kept == ("a",)
    assert seen == [(1, 1)]
    # What there was stays as it was: the new drive has a segment of its own.
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert len(segment_names(tmp_path)) == 2

    builder.layer("a.d1.1700000000000", "boxes", "petr@2", BOXES, [box(EPOCH, "t")])
    assert build_index(tmp_path).scenes_written == ("a", "b")
    incremental = tables_of(tmp_path)
    build_index(tmp_path, force=True)
    assert len(segment_names(tmp_path)) == 1
    assert tables_of(tmp_path) == incremental


def test_a_scene_that_is_gone_leaves_nothing_behind(tmp_path: Path) -> None:
    builder = two_scenes(tmp_path)
    build_index(tmp_path)
    for drive_id in ("d1", "d3"):
        shutil.rmtree(builder.layout.drive(drive_id))
    del builder.scenes["b"]
    builder.write_rois()
    build_index(tmp_path)
    left = mirror.open(tmp_path)
    assert left.scenes() == ["a"] and left.drives() == ["d2"]
    assert set(left.table("images", ["scene_id"]).column(0).to_pylist()) == {"a"}
    # Their files are gone, so that earlier snapshots are not opened.
    with pytest.raises(DatasetError, match="have been replaced or removed"):
        mirror.open(tmp_path, at=1)
    build_index(tmp_path, compact=True)
    assert not [name for name in index_bytes(tmp_path) if "b.parquet" in name]


@pytest.mark.parametrize("damage", ["images/a.parquet", "traversals.parquet", "manifest.json", "sources.json"])
def test_a_damaged_index_is_made_again(tmp_path: Path, damage: str) -> None:
    two_scenes(tmp_path)
    build_index(tmp_path)
    expected = index_bytes(tmp_path)
    path = segment_folder(tmp_path) / damage
    path.write_bytes(path.read_bytes()[:-7])
    assert build_index(tmp_path).scenes_written == ("a", "b")
    assert index_bytes(tmp_path) == expected


def test_a_run_killed_before_the_manifest_is_made_good(tmp_path: Path) -> None:
    builder = two_scenes(tmp_path)
    build_index(tmp_path)
    builder.drive("d4", [Pass("b", EPOCH + 900 * SECOND)])
    with interrupt_before("index/snapshots/*"):
        build_index(tmp_path)
    assert mirror.open(tmp_path).drives() == ["d1", "d2", "d3"]
    build_index(tmp_path)
    assert mirror.open(tmp_path).drives() == ["d1", "d2", "d3", "d4"]
    made_good = tables_of(tmp_path)
    build_index(tmp_path, force=True)
    assert tables_of(tmp_path) == made_good


def geo_of(path: Path) -> dict[str, object]:
    return json.loads(pq.read_metadata(path).metadata[b"geo"])


def test_scenes_and_traversals_are_geoparquet(tmp_path: Path) -> None:
    two_scenes(tmp_path)
    build_index(tmp_path)
    for name, kind in (("scenes", "Polygon"), ("traversals", "LineString")):
        path = segment_folder(tmp_path) / f"{name}.parquet"
        geo = geo_of(path)
        column = geo["columns"]["geometry"]
        assert geo["version"] == "1.1.0" and geo["primary_column"] == "geometry"
        assert column["encoding"] == "WKB" and column["geometry_types"] == [kind]
        assert pyproj.CRS.from_json_dict(column["crs"]) == pyproj.CRS("OGC:CRS84")
        assert column["covering"]["bbox"]["xmin"] == ["bbox", "xmin"]
        rows = pq.read_table(path).to_pylist()
        shapes = [shapely.from_wkb(row["geometry"]) for row in rows]
        assert [list(row["bbox"].values()) for row in rows] == [list(shape.bounds) for shape in shapes]
        assert np.allclose(shapely.total_bounds(shapes), column["bbox"], atol=0)
    scene = pq.read_table(segment_folder(tmp_path) / "scenes.parquet").to_pylist()[0]
    area, _ = GEOD.geometry_area_perimeter(shapely.from_wkb(scene["geometry"]))
    assert scene["traversals"] == 2 and scene["drives"] == 2 and scene["images"] == 29
    assert area == pytest.approx(np.pi * 200.0**2, rel=2e-4)
    for row in pq.read_table(segment_folder(tmp_path) / "traversals.parquet").to_pylist():
        length = GEOD.geometry_length(shapely.from_wkb(row["geometry"]))
        assert length == pytest.approx(row["path_m"], abs=1e-4)


def test_a_local_frame_has_no_geometry_and_no_crs(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a", frame="map", x_m=10.0, y_m=-4.0)
    builder.drive("d", [Pass("a")])
    build_index(tmp_path)
    column = geo_of(segment_folder(tmp_path) / "traversals.parquet")["columns"]["geometry"]
    assert column["crs"] is None and column["geometry_types"] == []
    row = mirror.open(tmp_path).table("traversals", ["geometry", "bbox"]).to_pylist()[0]
    assert row == {"geometry": None, "bbox": None}
    images = mirror.open(tmp_path).table("images", ["longitude_deg", "x_m"])
    assert images.column("longitude_deg").null_count == images.num_rows and images.column("x_m").null_count == 0


def test_shapes_do_not_break_at_the_antimeridian(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a", 179.9999, -17.0)
    one = Pass("a", frames=100, heading_deg=90.0)
    builder.drive("d", [one])
    build_index(tmp_path)
    scene, line = (
        shapely.from_wkb(pq.read_table(segment_folder(tmp_path) / f"{name}.parquet").column("geometry")[0].as_py())
        for name in ("scenes", "traversals")
    )
    assert scene.bounds[2] - scene.bounds[0] < 0.01
    assert line.bounds[2] - line.bounds[0] < 0.01
    images = mirror.open(tmp_path).to_pandas("images")
    assert images["longitude_deg"].between(-180, 180).all()
    *_, distance = GEOD.inv(
        np.full(len(images), 179.9999), np.full(len(images), -17.0), images["longitude_deg"], images["latitude_deg"]
    )
    assert np.abs(distance - np.abs(np.hypot(images["x_m"], images["y_m"]))).max() < 1e-3
    assert mirror.open(tmp_path).where(within=(-179.9999, -17.0, 60.0)).count("images") > 0


def test_a_redaction_layer_takes_the_place_of_the_recorded_bytes(tmp_path: Path) -> None:
    builder = two_scenes(tmp_path)
    traversal = "a.d1.1700000000000"
    recorded = read_table(builder.layout.recorded(traversal) / "images.parquet", IMAGES).to_pylist()
    for version, chosen in (("9", recorded[:1]), ("10", recorded[1:3])):
        rows = [{**row, "uri": f"blurred/{version}.jpg", "sha256": bytes(32), "privacy": "redacted"} for row in chosen]
        builder.layer(traversal, "redaction", f"anon@{version}", IMAGES, rows)
    build_index(tmp_path)
    images = mirror.open(tmp_path).where(traversal=traversal).table("images").to_pylist()
    redacted = [row for row in images if row["privacy"] == "redacted"]
    assert [row["timestamp_ns"] for row in redacted] == [row["timestamp_ns"] for row in recorded[1:3]]
    assert {row["uri"] for row in redacted} == {"blurred/10.jpg"}
    assert [row["source_sha256"] for row in redacted] == [row["sha256"] for row in recorded[1:3]]
    assert all(row["source_sha256"] is None for row in images if row["privacy"] == "raw")


def test_a_poses_only_drive_has_a_traversal_without_images(tmp_path: Path) -> None:
    builder = Builder(tmp_path, cameras=())
    builder.scene("a")
    builder.drive("d", [Pass("a")])
    build_index(tmp_path)
    dataset = mirror.open(tmp_path)
    row = dataset.table("traversals", ["has_images", "images", "frames", "cameras", "rig_id"]).to_pylist()[0]
    assert row == {"has_images": False, "images": 0, "frames": 0, "cameras": [], "rig_id": None}
    assert dataset.table("images").num_rows == 0 and len(dataset.frames()) == 0
    assert dataset.count("ego_poses") == dataset.table("ego_poses").num_rows > 0


def test_an_empty_dataset_has_an_index(tmp_path: Path) -> None:
    Builder(tmp_path)
    build_index(tmp_path)
    dataset = mirror.open(tmp_path)
    assert dataset.traversals() == [] and dataset.scenes() == [] and len(dataset.frames()) == 0
    assert dataset.where(within=(0.0, 0.0, 100.0), light="day").table("images").num_rows == 0


def test_poses_that_do_not_cover_an_image_are_named(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    late = Pass("a", frames=40)
    builder.image_table = lambda name, item: Builder.image_table(builder, name, late)  # type: ignore[method-assign]
    builder.drive("d", [Pass("a")])
    with pytest.raises(DatasetError, match="do not cover") as caught:
        build_index(tmp_path)
    assert "camera front_left, timestamp_ns" in str(caught.value) and "images.parquet" in str(caught.value)
    assert not (tmp_path / "index").exists()


def test_faults_of_the_inputs_are_named(tmp_path: Path) -> None:
    builder = two_scenes(tmp_path)
    recorded = builder.layout.recorded("a.d1.1700000000000") / "manifest.json"
    whole = recorded.read_bytes()
    recorded.write_bytes(whole.replace(b'"count"', b'"count" '))
    with pytest.raises(DatasetError, match="not the traversal that its drive was written with"):
        build_index(tmp_path)
    recorded.unlink()
    with pytest.raises(DatasetError, match="missing"):
        build_index(tmp_path)
    recorded.write_bytes(whole)

    rois = builder.layout.rois.read_bytes()
    for broken, message in (
        (b"{", "not valid JSON"),
        (b"[]", "not a FeatureCollection"),
        (rois.replace(b'"scene_id": "a"', b'"scene_id": "b"'), "twice"),
        (rois.replace(b'"radius_m": 200.0', b'"radius_m": -1'), "greater than 0"),
    ):
        builder.layout.rois.write_bytes(broken)
        with pytest.raises(SchemaError, match=message):
            build_index(tmp_path)
    builder.layout.rois.write_bytes(rois.replace(b'"scene_id": "a"', b'"scene_id": "c"'))
    with pytest.raises(DatasetError, match=r"the scene of traversal .* is missing"):
        build_index(tmp_path)
    builder.layout.rois.unlink()
    with pytest.raises(DatasetError, match="missing"):
        build_index(tmp_path)


def test_a_missing_table_is_named(tmp_path: Path) -> None:
    builder = two_scenes(tmp_path)
    (builder.layout.recorded("a.d1.1700000000000") / "ego_poses.parquet").unlink()
    with pytest.raises(DatasetError, match=r"ego_poses\.parquet"):
        build_index(tmp_path)


def test_an_image_table_in_another_order_gives_the_same_index(tmp_path: Path) -> None:
    for name, flip in (("one", False), ("two", True)):
        builder = Builder(tmp_path / name)
        builder.scene("a")
        plain = builder.image_table

        def images(traversal_id: str, item: Pass, plain=plain, flip=flip) -> pa.Table:
            table = plain(traversal_id, item)
            return table.take(pa.array(np.arange(table.num_rows)[::-1])) if flip else table

        builder.image_table = images  # type: ignore[method-assign]
        builder.drive("d", [Pass("a")])
        build_index(tmp_path / name)
    one, two = index_bytes(tmp_path / "one"), index_bytes(tmp_path / "two")
    assert one["images/a.parquet"] == two["images/a.parquet"]
