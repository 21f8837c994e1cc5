from __future__ import annotations

import base64
import re
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

import mirror
from mirror.errors import DatasetError
from mirror.ingest.run import ingest
from mirror.view.report import write_report
from mirror.view.svg import Line, bars, scene_map
from tests.ingest.recordings import SCENE, START_NS, write_recording


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> mirror.Dataset:
    root = tmp_path_factory.mktemp("report")
    drives = [
        write_recording(root, "there"),
        write_recording(root, "edge", start_ns=START_NS + 10**13, from_m=-120, to_m=-50, seed=2),
    ]
    ingest(drives, [SCENE], root / "d")
    return mirror.open(root / "d")


def test_report_is_one_page_with_every_camera_and_every_refused_pass(dataset: mirror.Dataset, tmp_path: Path) -> None:
    write_report(dataset, tmp_path / "r.html", "A <title> & more")
    page = (tmp_path / "r.html").read_text()
    assert "A &lt;title&gt; &amp; more" in page
    assert not re.findall(r"(?:src|href)=\"(?!data:)", page), "nothing is loaded from elsewhere"
    pictures = re.findall(r'alt="(\w+)" src="data:image/jpeg;base64,([^"]+)"', page)
    assert [camera for camera, _ in pictures] == ["front_wide", "rear"]
    frame = dataset.frames()[len(dataset.frames()) // 2]
    for camera, data in pictures:
        shown = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR_RGB)
        assert np.abs(shown.astype(int) - frame.images[camera].decode()).mean() < 6
    assert page.count("<td>min_duration</td>") == 1
    assert "2 passes: 1 accepted, 1 refused" in page


def test_report_that_cannot_be_written_leaves_the_old_one(dataset: mirror.Dataset, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")
    with pytest.raises(DatasetError, match="cannot be written"):
        write_report(dataset, tmp_path / "file" / "r.html")
    assert (tmp_path / "file").read_text() == "old"


def test_map_has_north_up_and_true_scale() -> None:
    line = Line(np.array([0.0, 0.0]), np.array([0.0, 50.0]), "day", "north & <b>")
    drawing = re.search(r"<svg.*</svg>", scene_map("a < b", 100.0, [line]))
    assert drawing is not None
    root = ElementTree.fromstring(drawing.group())
    group = root.find("g")
    assert group is not None
    assert group.find("polyline").get("points") == "0.0,-0.0 0.0,-50.0"
    assert group.find("path").get("transform") == "translate(0.0 -50.0) rotate(-90.0)"
    assert root.find("circle").get("r") == "100.0"
    assert "50 m" in "".join(root.itertext())


def test_bars_are_proportional_and_zero_is_nothing() -> None:
    drawing = re.search(r"<svg.*</svg>", bars("t", {"a": 4.0, "b": 1.0, "c": 0.0}))
    assert drawing is not None
    widths = [float(rect.get("width")) for rect in ElementTree.fromstring(drawing.group()).iter("rect")]
    assert widths == [260.0, 65.0, 0.0]
    assert "nan" not in bars("t", {"a": 0.0})
    assert "<svg" in bars("t", {})
