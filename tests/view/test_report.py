"""The report of a small synthetic dataset: well-formed, self-contained, and equal to the tables."""

import base64
import re
import shutil
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
import mirror.synth
from mirror.dataset.dataset import Dataset
from mirror.dataset.statistics import compute_statistics
from mirror.errors import DatasetError
from mirror.geometry.box_projection import project_boxes
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import read_rois
from mirror.ingest.run import ingest_recordings
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.view.images import busiest_frame, category_colours, legend, rig_images, same_place
from mirror.view.report import map_legend, write_report
from mirror.view.svg import MapTrack, scene_map

VOID = {"meta", "img", "input", "br"}
RASTERS = {(90, 160, 3), (104, 192, 3), (76, 120, 3), (72, 128, 3), (69, 128, 3)}


class Page(HTMLParser):
    """Counts tags, refuses crossed ones, gathers attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def count(self, tag: str) -> int:
        return sum(name == tag for name, _ in self.tags)


@pytest.fixture(scope="module")
def dataset(tiny_dataset: Dataset) -> Dataset:
    return tiny_dataset


@pytest.fixture(scope="module")
def recordings(dataset: Dataset) -> list[Path]:
    return sorted(file.parent for file in (Path(dataset.root).parent / "tiny").glob("*/recording.json"))


@pytest.fixture(scope="module")
def page(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Page:
    out = tmp_path_factory.mktemp("view") / "report.html"
    write_report(dataset, out, "A <title> & more")
    return Page(out.read_text())


def test_page_is_well_formed_and_self_contained(page: Page) -> None:
    assert page.open == []
    assert page.count("script") == page.count("link") == page.count("iframe") == 0
    assert "A <title> & more" in page.text
    for _, attributes in page.tags:
        for name in ("src", "href", "action", "data"):
            value = attributes.get(name)
            assert value is None or value.startswith("data:image/jpeg;base64,")
    style = page.text[page.text.index(":root") :]
    assert "url(" not in style and "@import" not in style


def test_every_inlined_image_decodes(page: Page) -> None:
    sources = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    # One instant, eight instants over the time as thumbnails and as images, one place of two traversals, and two
    # conditions with seven cameras each.
    assert len(sources) == 7 + 8 * (7 + 7) + 2 + 2 * 7
    for source in sources:
        data = np.frombuffer(base64.b64decode(source.split(",")[1]), np.uint8)
        assert cv2.imdecode(data, cv2.IMREAD_COLOR).shape in RASTERS


def test_page_shows_the_rows_of_the_tables(page: Page, dataset: Dataset) -> None:
    for camera in CANONICAL_CAMERAS:
        assert camera in page.text
    for row in dataset.table("traversals").to_pylist():
        assert f"{row['duration_s']:.1f} s" in page.text
        assert row["vehicle_id"] in page.text
    refused = [row for row in dataset.passes().to_pylist() if row["decision"] == "refused"]
    assert len(refused) == 1
    assert refused[0]["rule"] == "min_duration"
    assert "time inside too short" in page.text
    assert f"{refused[0]['measured']:.3g} s" in page.text
    assert "held out" in page.text and "train" in page.text
    for (category,) in {(row["category"],) for row in dataset.table("boxes", ["category"]).to_pylist()}:
        assert category in page.text


def test_charts_draw_the_counts(page: Page, dataset: Dataset) -> None:
    labels = {attributes.get("aria-label") for tag, attributes in page.tags if tag == "svg"}
    assert {"Traversals by light and weather", "Boxes by category", "Images by camera"} <= labels
    assert f"{dataset.count('images')}" in page.text.replace(",", "")
    assert f"{dataset.count('boxes')}" in page.text.replace(",", "")


def test_boxes_are_projected_through_the_lens(dataset: Dataset) -> None:
    frame = busiest_frame(dataset, dataset.traversals())
    assert set(frame.images) == set(CANONICAL_CAMERAS)
    html = rig_images(frame, boxes=True, width_px=640)
    shown = 0
    for figure in re.findall(r"<figure.*?</figure>", html, re.DOTALL):
        camera = re.search(r'alt="(\w+)"', figure).group(1)
        drawing = ElementTree.fromstring(re.search(r"<svg.*</svg>", figure, re.DOTALL).group(0))
        lens = frame.images[camera].camera_model
        assert drawing.get("viewBox") == f"0 0 {lens.width_px} {lens.height_px}"
        boxes = frame.boxes(f"camera:{camera}")
        projected = project_boxes(lens, boxes.pose, boxes.size_m)
        paths = drawing.findall("path")
        assert len(paths) == projected.visible.sum()
        for path, row in zip(paths, [r for r in far_first(boxes) if projected.visible[r]]):
            points = np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path.get("d")), float)
            low, high = points.min(axis=0), points.max(axis=0)
            u0, v0, u1, v1 = projected.bounds_px[row]
            # Bounds are of the part within the raster: only of a box that is whole are they those of its edges.
            if min(u0, v0) > 0.5 and u1 < lens.width_px - 0.5 and v1 < lens.height_px - 0.5:
                assert np.abs(low - (u0, v0)).max() < 0.3
                assert np.abs(high - (u1, v1)).max() < 0.3
                shown += 1
    assert shown > 10


def far_first(boxes) -> np.ndarray:
    return np.argsort(-np.linalg.norm(boxes.pose.translation, axis=1))


def test_passages_are_at_the_same_place(dataset: Dataset) -> None:
    passages = same_place(dataset, dataset.table("traversals").to_pylist())
    assert len(passages) == 2
    assert sorted(one.is_same_direction for one in passages) == [False, True]
    places = []
    for one in passages:
        frames = dataset.where(traversal=one.traversal["traversal_id"]).table("frames").to_pylist()
        row = next(row for row in frames if row["frame_index"] == one.frame_index)
        places.append((row["x_m"], row["y_m"]))
    assert np.hypot(*np.subtract(*places)) < 12.0


def test_report_without_images_or_traversals(recordings: list[Path], tmp_path: Path) -> None:
    ingest_recordings(
        recordings[2:], read_rois(recordings[0].parent / "rois.geojson"), tmp_path / "bare", IngestOptions()
    )
    write_report(mirror.open(tmp_path / "bare"), tmp_path / "bare.html")
    page = Page((tmp_path / "bare.html").read_text())
    assert page.open == []
    assert page.count("img") == 0
    assert "No traversal has images" in page.text
    assert "time inside too short" in page.text


def test_tiles_agree_with_the_statistics(dataset: Dataset, recordings: list[Path], tmp_path: Path) -> None:
    ingest_recordings(
        recordings[2:], read_rois(recordings[0].parent / "rois.geojson"), tmp_path / "bare", IngestOptions()
    )
    for one in (dataset, mirror.open(tmp_path / "bare")):
        write_report(one, tmp_path / "page.html")
        html = (tmp_path / "page.html").read_text()
        tiles = {name: value for value, name in re.findall(r'class="tile"><b>(.*?)</b><span>(.*?)</span>', html)}
        row = compute_statistics(one).row
        assert (tiles["scenes"], tiles["cities"]) == (str(row.scenes), str(len(row.cities)))
        assert tiles["km² of scenes"] == f"{row.area_km2:.3f}"


def test_only_maps_of_the_globe_point_north() -> None:
    line = MapTrack(np.array([0.0, 9.0]), np.array([0.0, 9.0]), "unknown", "one")
    assert "N ↑" in scene_map("a", 100.0, [line], north=True)
    assert "N ↑" not in scene_map("a", 100.0, [line], north=False)


def test_unknown_light_has_a_legend_entry() -> None:
    assert map_legend({"unknown", "day"}).count('class="swatch') == 2
    assert '<i class="swatch unknown"></i>unknown' in map_legend({"unknown", "day"})


def test_other_categories_have_different_colours() -> None:
    colours = category_colours(["car", "Car", "Truck", "Pedestrian"])
    assert len(set(colours.values())) == 4
    shown = legend(["car", "Car", "Truck", "Pedestrian"])
    assert 'class="swatch c0"></i>car<' in shown
    for name in ("Car", "Truck", "Pedestrian"):
        assert f'class="swatch cx" style="--hue:{colours[name].hue}"></i>{name}<' in shown


def test_truncated_image_is_an_error(dataset: Dataset, tmp_path: Path) -> None:
    root = Path(shutil.copytree(dataset.root, tmp_path / "copy"))
    for file in root.glob("traversals/*/recorded/**/*.jpg"):
        file.write_bytes(file.read_bytes()[:400])
    with pytest.raises(DatasetError):
        write_report(mirror.open(root), tmp_path / "page.html")
