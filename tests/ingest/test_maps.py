"""Recorded road maps: taken into a dataset, read again, replaced, and refused where they do not fit."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.generation import recover, supersede
from mirror.dataset.index import build_index
from mirror.dataset.layout import Layout
from mirror.errors import DatasetError, MirrorError, SchemaError, UsageError
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.schema.road_map import RoadMap, encode_road_map, write_road_map
from tests.builders.folder import SCENE, write_recording
from tests.ingest.maps import east_map


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recording(tmp_path_factory.mktemp("recordings"), "east")


def ingest(recordings: list[Path], out: Path, *maps: Path, replace: bool = False) -> dict[str, str]:
    options = IngestOptions(maps=maps, replace=replace, workers=1)
    return dict(ingest_recordings(recordings, [SCENE], out, options).maps)


@pytest.fixture(scope="module")
def plain(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset without a map; tests add maps to copies of it, or read it."""
    out = tmp_path_factory.mktemp("plain") / "dataset"
    ingest([recording], out)
    return out


def test_a_map_is_the_only_change_and_is_read_back(recording: Path, plain: Path, tmp_path: Path) -> None:
    out, file = tmp_path / "dataset", tmp_path / "maps" / "street.parquet"
    write_road_map(file, east_map())
    assert ingest([recording], out, file.parent) == {"street": "added"}
    dataset = mirror.open(out)
    read = dataset.road_map()
    assert read is not None and encode_road_map(read) == file.read_bytes()
    assert (out / "maps" / "street" / "map.parquet").read_bytes() == file.read_bytes()
    added = {path.relative_to(out) for path in out.rglob("*")} - {path.relative_to(plain) for path in plain.rglob("*")}
    assert {str(path) for path in added if path.parts[0] != "index"} == {
        "maps",
        "maps/street",
        "maps/street/manifest.json",
        "maps/street/map.parquet",
    }
    assert mirror.open(plain).road_map("street") is None
    assert dataset.index_sha256 != mirror.open(plain).index_sha256
    # Without the map, the index has the bytes that it had before there were maps.
    shutil.rmtree(out / "maps")
    build_index(out)
    assert mirror.open(out).index_sha256 == mirror.open(plain).index_sha256


def test_a_map_comes_later_without_a_recording_and_views_keep_theirs(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, first, second = tmp_path / "dataset", tmp_path / "first.parquet", tmp_path / "second.parquet"
    write_road_map(first, east_map())
    write_road_map(second, east_map(aside_m=1.0))
    ingest([recording], out)
    assert main(["ingest", "--map", str(first), "--out", str(out)]) == 0
    assert "road maps: street added" in capsys.readouterr().out
    before = mirror.open(out)
    assert ingest([], out, first) == {"street": "unchanged"}
    with pytest.raises(UsageError, match="has another map of scene street"):
        ingest([recording], out, second)
    assert ingest([], out, second, replace=True) == {"street": "replaced"}
    # A run that ended between two renames: the next one restores the map.
    supersede(Layout(out), out / "maps" / "street")
    recover(Layout(out))
    for dataset, aside_m in ((before, 0.0), (mirror.open(out), 1.0)):
        road_map = dataset.road_map()
        assert road_map is not None and (road_map.lanes["only"].center_m[:, 1] == aside_m).all()
    assert main(["info", str(out)]) == 0
    assert "1: street 1" in next(line for line in capsys.readouterr().out.splitlines() if "road maps" in line)
    assert main(["ingest", "--map", str(first), "--out", str(tmp_path / "none")]) == 2


@pytest.mark.parametrize(
    ("road_map", "error", "message"),
    [
        (east_map("elsewhere"), UsageError, "a map of scene elsewhere"),
        (east_map(frame="site"), UsageError, "a map in the frame site"),
        (east_map(aside_m=500.0), UsageError, "the nearest lane or drivable area is 496 m from the centre"),
    ],
)
def test_a_map_that_does_not_fit_is_refused_before_anything_is_written(
    road_map: RoadMap, error: type[MirrorError], message: str, recording: Path, tmp_path: Path
) -> None:
    file = tmp_path / "map.parquet"
    write_road_map(file, road_map)
    with pytest.raises(error, match=message) as caught:
        ingest([recording], tmp_path / "dataset", file)
    assert caught.value.file == str(file)
    assert not (tmp_path / "dataset").exists()


def test_files_that_are_no_maps_are_refused(recording: Path, tmp_path: Path) -> None:
    file, out = tmp_path / "map.parquet", tmp_path / "dataset"
    data = encode_road_map(east_map())
    for broken in (b"", b"PAR1", data[:-20], data[:200] + bytes(50) + data[250:]):
        file.write_bytes(broken)
        with pytest.raises(SchemaError) as caught:
            ingest([recording], out, file)
        assert caught.value.file == str(file)
    with pytest.raises(DatasetError, match="cannot be read"):
        ingest([recording], out, tmp_path / "missing.parquet")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="no map in the folder"):
        ingest([recording], out, tmp_path / "empty")
    file.write_bytes(data)
    with pytest.raises(UsageError, match="is a map of scene street too"):
        ingest([recording], out, file, file)


def test_a_map_that_was_changed_in_the_dataset_is_not_read_and_is_repaired(recording: Path, tmp_path: Path) -> None:
    out, file = tmp_path / "dataset", tmp_path / "map.parquet"
    write_road_map(file, east_map())
    ingest([recording], out, file)
    stored = out / "maps" / "street" / "map.parquet"
    write_road_map(stored, replace(east_map(), fitted=True))
    with pytest.raises(DatasetError, match="not the file that was written"):
        mirror.open(out).road_map()
    assert ingest([], out, file) == {"street": "replaced"}
    assert mirror.open(out).road_map() is not None
