"""A scene in a file of rerun has the poses, lenses, images, boxes and points of the dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.index.build import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.dataset.times import solar_time
from mirror.schema.files import read_table
from mirror.schema.tables import BOXES
from mirror.view.rerun_log import RerunOptions, log_scene
from tests.builders.street import make_street

rerun_chunk = pytest.importorskip("rerun.chunk", reason="the extra view is not installed")


def test_the_file_has_what_the_dataset_has(street: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "street.rrd"
    logged = log_scene(street, "a", RerunOptions(out))
    assert (logged.frames, logged.images, logged.boxes, logged.points) == (10, 20, 20, 14)
    chunks = list(rerun_chunk.RrdReader(str(out)).stream())
    assert chunks
    paths = {str(chunk.entity_path).lstrip("/") for chunk in chunks}
    traversal = street.traversals()[0]
    wanted = {f"world/{traversal}/{name}" for name in ("ego", "boxes", "front_wide", "rear/image")}
    assert wanted <= paths
    assert {"world/points", f"world/trajectories/{traversal}"} <= paths
    found = [
        row
        for chunk in chunks
        if str(chunk.entity_path).lstrip("/") == f"world/{traversal}/front_wide"
        for row in chunk.to_record_batch().to_pylist()
    ]
    frames = list(street.where(traversal=traversal).frames())
    positions = [row["Transform3D:translation"][0] for row in found if row.get("Transform3D:translation")]
    expected = np.array([frame.images["front_wide"].world_SE3_camera.translation[0] for frame in frames])
    np.testing.assert_allclose(np.array(positions), expected, atol=1e-4)
    masked = [image for frame in frames for image in frame.images.values() if image.masks()]
    shown = {
        (str(chunk.entity_path), value)
        for chunk in chunks
        if "/masks/" in str(chunk.entity_path)
        for row in chunk.to_record_batch().to_pylist()
        for buffer in row.get("SegmentationImage:buffer") or ()
        for value in np.unique(np.asarray(buffer, np.uint8)).tolist()
    }
    kinds = {mask.kind for image in masked for mask in image.masks()}
    assert masked and kinds == {path.rsplit("/", 1)[1] for path, _ in shown}
    # Nothing is 0, which has no colour; each kind has a class of its own.
    classes = {path.rsplit("/", 1)[1]: value for path, value in shown if value}
    assert len(set(classes.values())) == len(kinds) and {value for _, value in shown} == {0, *classes.values()}


def test_the_layout_has_the_scene_and_a_tab_for_each_traversal(street: Dataset, tmp_path: Path) -> None:
    """Without a layout, rerun opens a view for each camera of each traversal."""
    out = tmp_path / "street.rrd"
    log_scene(street, "a", RerunOptions(out, every=5))
    found: dict[str, set[str]] = {"ViewBlueprint:class_identifier": set(), "ViewBlueprint:space_origin": set()}
    tabs = set()
    rows = street.table("traversals").to_pylist()
    times = [solar_time(row["entry_ns"], row["bbox"]["xmin"]) for row in rows]
    titles = {
        f"{row['light']}, {row['weather']}: {row['drive_id']} {time} solar time" for row, time in zip(rows, times)
    }
    reader = rerun_chunk.RrdReader(str(out))
    (layout,) = reader.blueprints()
    for chunk in reader.stream(store=layout):
        for row in chunk.to_record_batch().to_pylist():
            for name, values in found.items():
                values |= set(row.get(name) or ())
            tabs |= {name for name in row.get("ContainerBlueprint:display_name") or () if name in titles}
    assert found["ViewBlueprint:class_identifier"] == {"3D", "2D", "TextLog"}
    cameras = {f"world/{traversal}/{camera}" for traversal in street.traversals() for camera in street.cameras()}
    assert cameras | {"world", "conditions"} == {origin.strip("/") for origin in found["ViewBlueprint:space_origin"]}
    assert len(tabs) == 2


def test_the_verb(street: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "night.rrd"
    words = ["view", street.root, "--traversal", street.traversals()[1], "--camera", "rear", "--every", "2"]
    assert main([*words, "--save", str(out)]) == 0
    assert capsys.readouterr().out.startswith("3 frames, 3 images, 6 boxes, 7 points")
    assert out.stat().st_size > 1000
    assert not [path for path in tmp_path.iterdir() if path.name.endswith(".tmp")]
    assert main([*words, "--save", str(tmp_path / "a" / "b" / "night.rrd")]) == 0
    assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == ["night.rrd"]
    assert main([*words, "--save", str(out / "night.rrd")]) == 2
    assert "night.rrd is a file" in capsys.readouterr().err
    assert main([*words, "--save", f"{street.root}/x.rrd"]) == 2


def test_a_layer_to_choose_is_chosen_by_an_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    street = make_street(tmp_path / "dataset", ("front_wide",))
    builder = Layout(tmp_path / "dataset")
    first, second = street.traversals()
    rows = read_table(builder.layer(first, "boxes", "petr", "1") / "boxes.parquet", BOXES).to_pylist()
    LayerWriter(builder, first, "boxes", "other", "2").finish(BOXES, rows[:3], {})
    build_index(tmp_path / "dataset")
    words = ["view", street.root, "--save", str(tmp_path / "street.rrd")]
    export = ["export", "kitti", street.root, "--out", str(tmp_path / "kitti")]
    for command in (words, export):
        assert main(command) == 2
        assert "--boxes petr@1" in (said := capsys.readouterr().err) and "with_layers" not in said
        assert main([*command, "--boxes", "other@2"]) == 2
        said = capsys.readouterr().err
        assert "name another with --boxes" in said and second in said and "with_layers" not in said
    assert main([*words, "--boxes", "other@2", "--traversal", first]) == 0
    assert "3 boxes" in capsys.readouterr().out
    assert main([*words, "--boxes", "petr@1"]) == 0
    assert "20 boxes" in capsys.readouterr().out
    for kind in ("points", "poses"):
        assert main([*words, "--boxes", "petr@1", f"--{kind}", "none@1"]) == 2
        assert f"--{kind}" in capsys.readouterr().err
