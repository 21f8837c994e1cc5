"""One instant from above, the cameras over time, a place in two lights, and the ground below a map."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from shapely import Point, Polygon

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.geometry.geodesy import surface_distance_m
from mirror.view.aerial import AerialImage
from mirror.view.images import busiest_frame, compare_lights, same_place
from mirror.view.instant import REACH_M, cameras_over_time, draw_from_above, trace_cone
from mirror.view.report import write_report
from tests.leaderboard.browser import Browser


def outlines(drawing: str, pattern: str) -> list[np.ndarray]:
    """Points of the ego frame: x ahead, y to the left."""
    found = re.findall(pattern, drawing)
    return [-np.array([point.split(",") for point in points.split()], float)[:, ::-1] for points in found]


def test_boxes_from_above_are_those_of_the_frame(tiny_dataset: Dataset) -> None:
    frame = busiest_frame(tiny_dataset, tiny_dataset.traversals())
    boxes = frame.boxes()
    shown = outlines(draw_from_above(frame, boxes=True), r'<title>[^<]*</title><polygon points="([^"]*)"/><polyline')
    near = [row for row in range(len(boxes)) if np.abs(boxes.pose.translation[row, :2]).max() < REACH_M - 8.0]
    assert near and len(shown) >= len(near)
    for row in near:
        middle, (length, width) = boxes.pose.translation[row, :2], boxes.size_m[row, :2]
        nearest = min(shown, key=lambda outline: np.hypot(*(outline.mean(axis=0) - middle)))
        assert np.hypot(*(nearest.mean(axis=0) - middle)) < 0.02
        # Boxes on a street are almost level: their areas from above are those of their sides.
        assert Polygon(nearest).area == pytest.approx(length * width, rel=0.03)
    assert "<polyline" not in draw_from_above(frame, boxes=False)


def test_cones_hold_what_the_cameras_see(tiny_dataset: Dataset) -> None:
    frame = busiest_frame(tiny_dataset, tiny_dataset.traversals())
    rng = np.random.default_rng(0)
    for image in frame.images.values():
        cone = Polygon(trace_cone(frame, image))
        lens, ego_SE3_camera = image.camera_model, frame.world_SE3_ego.inverse() @ image.world_SE3_camera
        angles = rng.uniform(-np.pi, np.pi, 300)
        around = ego_SE3_camera.translation[0] + 9.0 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(300)])
        projected = lens.project(ego_SE3_camera.inverse().transform(around)[0])
        u = projected.uv_px[:, 0]
        seen = projected.valid & (u >= 0) & (u <= lens.width_px)
        inside = np.array([cone.contains(Point(point[:2])) for point in around])
        # The middle row's ends bound the cone: other rows differ by a degree or two.
        assert (seen == inside).mean() > 0.96, image.camera


def test_each_time_has_its_thumbnails_and_its_images(tiny_dataset: Dataset) -> None:
    name = tiny_dataset.traversals()[0]
    part = cameras_over_time(tiny_dataset, name, width_px=100)
    assert part is not None
    cameras = len(tiny_dataset.where(traversal=name).cameras())
    assert part.count('<input type="radio"') == part.count('<div class="chosen">') == 8
    assert part.count("checked") == 1 and part.count("<i><img") == 8 * cameras
    times = [float(text) for text in re.findall(r"<span>([\d.]+) s</span>", part)]
    stamps = tiny_dataset.where(traversal=name).table("frames", ["timestamp_ns"]).column(0).to_numpy()
    assert times[0] == 0.0 and times[-1] == pytest.approx((stamps[-1] - stamps[0]) * 1e-9, abs=0.06)
    assert times == sorted(times)


def test_a_place_by_day_stands_over_the_same_place_by_night(tiny_dataset: Dataset) -> None:
    passages = same_place(tiny_dataset, tiny_dataset.table("traversals").to_pylist())
    part = compare_lights(tiny_dataset, passages, "one", width_px=640)
    lights = {(one.traversal["light"], one.is_same_direction) for one in passages}
    pairs = any(("day", way) in lights and {("night", way), ("dusk", way)} & lights for way in (True, False))
    assert (part is not None) == pairs
    forced = [one for one in passages if one.is_same_direction] * 2
    other = dict(forced[0].traversal, light="night" if forced[0].traversal["light"] == "day" else "day")
    forced[1] = type(forced[1])(other, forced[0].frame_index, 1.0, True)
    part = compare_lights(tiny_dataset, forced, "one", width_px=640)
    assert part is not None and part.count("<img") == 2 and part.index("◂ day") < part.index("night")


@pytest.fixture
def ground(tmp_path: Path) -> Path:
    """Red grows with the longitude by column, green with the row from the north."""
    rows, columns = np.mgrid[:200, :250]
    cv2.imwrite(str(tmp_path / "ground.png"), np.dstack([0 * rows, rows, columns]).astype(np.uint8))
    return tmp_path / "ground.png"


def test_the_ground_is_cut_where_the_scene_lies(ground: Path) -> None:
    west, south, east, north = bounds = (13.0, 55.0, 13.02, 55.01)
    image = AerialImage(ground, bounds)
    cut = image.cut(13.008, 55.004, 200.0, 101)
    assert cut is not None
    # PROJ's distances from the middle to the edges of the file's pixels tell where the pixels must be.
    for column, row in ((50, 50), (50, 5), (50, 95), (5, 50), (95, 50)):
        red, green, _ = cut[row, column].astype(float)
        lon, lat = west + (red + 0.5) / 250 * (east - west), north - (green + 0.5) / 200 * (north - south)
        expected = np.hypot(column - 50, row - 50) / 101 * 400.0
        found = float(surface_distance_m(13.008, 55.004, lon, lat))
        assert found == pytest.approx(expected, abs=6.5)
        assert np.sign(round(lon - 13.008, 4)) == np.sign(column - 50)
        assert np.sign(round(55.004 - lat, 4)) == np.sign(row - 50)
    assert image.cut(14.0, 55.004, 200.0, 101) is None
    edge = image.cut(13.0, 55.0, 200.0, 101)
    assert edge is not None and (edge[-1, 0] == 128).all()


def test_ground_without_bounds_and_other_files_are_refused(
    tiny_dataset: Dataset, ground: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "page.html")
    assert main(["report", tiny_dataset.root, "--out", out, "--aerial", str(ground)]) == 2
    assert "--aerial-bounds" in capsys.readouterr().err
    with pytest.raises(UsageError, match="west, south, east, north"):
        AerialImage(ground, (13.0, 55.0, 12.0, 56.0))
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(UsageError, match="no image"):
        AerialImage(tmp_path / "text.png", (13.0, 55.0, 13.1, 55.1)).cut(13.05, 55.05, 10.0, 8)
    with pytest.raises(UsageError, match="cannot be read"):
        AerialImage(tmp_path / "absent.png", (13.0, 55.0, 13.1, 55.1)).cut(13.05, 55.05, 10.0, 8)
    place = tiny_dataset.table("scenes").to_pylist()[0]
    lon, lat = place["longitude_deg"], place["latitude_deg"]
    bounds = [str(value) for value in (lon - 0.01, lat - 0.01, lon + 0.01, lat + 0.01)]
    assert main(["report", tiny_dataset.root, "--out", out, "--aerial", str(ground), "--aerial-bounds", *bounds]) == 0
    assert '<image x="-' in Path(out).read_text()


def test_a_report_fits_a_phone_and_a_choice_changes_the_images(
    tiny_dataset: Dataset, tmp_path: Path, browser: Browser
) -> None:
    write_report(tiny_dataset, tmp_path / "report.html")
    for width in (1280, 390):
        browser.open(tmp_path / "report.html", width=width, height=800)
        assert browser.script("document.documentElement.scrollWidth") <= width
        # Tables do not scroll sideways on a phone.
        wide = "[...document.querySelectorAll('.stack .scroll')].some(one => one.scrollWidth > one.clientWidth + 1)"
        assert width > 390 or not browser.script(wide)
        assert browser.script("[...document.images].filter(one => one.width > one.naturalWidth + 1).length") == 0
        browser.script("document.querySelectorAll('.times input')[3].click()")
        shown = "[...document.querySelectorAll('.times .chosen')].map(one => one.getClientRects().length > 0)"
        assert browser.script(shown) == [place == 3 for place in range(8)]
