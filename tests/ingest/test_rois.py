from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.errors import DatasetError, MirrorError, SchemaError, UsageError
from mirror.ingest.rois import merge_rois, parse_roi, read_rois, refuse_swapped_coordinates, write_rois
from mirror.schema.documents import Roi

MUNICH = Roi(scene_id="munich", longitude_deg=11.5755, latitude_deg=48.1374, city="Munich", scene_type="urban")
YARD = Roi(scene_id="yard", frame="slam_7", x_m=10.0, y_m=-2.0, radius_m=40.0)


def test_geojson_round_trip(tmp_path: Path) -> None:
    write_rois(tmp_path / "r.geojson", [YARD, MUNICH])
    assert read_rois(tmp_path / "r.geojson") == [MUNICH, YARD]
    document = json.loads((tmp_path / "r.geojson").read_text())
    assert document["features"][0]["geometry"] == {"type": "Point", "coordinates": [11.5755, 48.1374]}
    assert document["features"][1]["geometry"] is None


def test_plain_geojson_and_csv(tmp_path: Path) -> None:
    feature = {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [8.5, 47.3, 400]},
        "properties": {"name": "z"},
    }
    (tmp_path / "a.json").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    assert read_rois(tmp_path / "a.json") == [Roi(scene_id="z", longitude_deg=8.5, latitude_deg=47.3)]
    (tmp_path / "a.csv").write_text("scene_id,lon,lat,radius_m,comment\nz,8.5,47.3,,x\ny,-70.0,-33.4,150,\n")
    first, second = read_rois(tmp_path / "a.csv")
    assert (first.radius_m, second.radius_m, second.latitude_deg) == (200.0, 150.0, -33.4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no ROI in it"),
        ('{"type": "FeatureCollection", "features": [', "line 1"),
        ('{"type": "Point"}', "FeatureCollection"),
        (
            '{"type": "FeatureCollection", "features": [{"geometry": {"type": "Polygon", "coordinates": []}}]}',
            "feature 0",
        ),
        ("scene_id,lon,lat\na,11.5,48.1\nb,48.1,116.3\n", r"line 3.*off the globe.*exchange"),
        ("scene_id,lon,lat\na,11.5,48.1\na,11.6,48.1\n", "stands twice"),
        ("scene_id,lon,lat\n../a,11.5,48.1\n", r"line 2.*scene_id"),
        ("scene_id,lon,lat,radius_m\na,11.5,48.1,-5\n", r"line 2.*radius_m"),
        ("scene_id,lon,lat\na,east,48.1\n", r"line 2.*longitude_deg"),
    ],
)
def test_bad_files_name_the_place(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "rois"
    path.write_text(text)
    with pytest.raises(SchemaError, match=says) as caught:
        read_rois(path)
    assert str(path) in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="missing"):
        read_rois(tmp_path / "none.geojson")


def test_command_line_roi() -> None:
    assert parse_roi("11.5,48.1") == Roi(scene_id="roi_11d50000_48d10000", longitude_deg=11.5, latitude_deg=48.1)
    assert parse_roi("-3.7, 40.4, 150, madrid").scene_id == "madrid"
    for wrong in ("11.5", "a,b", "11.5,148", "1,2,3,4,5", "nan,nan", "11.5,48,-1"):
        with pytest.raises(MirrorError):
            parse_roi(wrong)


def test_same_id_with_another_centre_is_refused(tmp_path: Path) -> None:
    assert merge_rois([MUNICH], [MUNICH, YARD], tmp_path) == [MUNICH, YARD]
    with pytest.raises(DatasetError, match="another centre"):
        merge_rois([MUNICH], [MUNICH.model_copy(update={"radius_m": 150.0})], tmp_path)


def test_exchanged_coordinates_are_recognised_by_where_was_driven() -> None:
    swapped = Roi(scene_id="s", longitude_deg=48.1374, latitude_deg=11.5755)
    with pytest.raises(UsageError, match="exchanged"):
        refuse_swapped_coordinates([swapped], 11.58, 48.14)
    refuse_swapped_coordinates([MUNICH, YARD], 11.58, 48.14)
    refuse_swapped_coordinates([MUNICH], -70.0, -33.0)
