"""docs/loading.md runs as it stands, and what it projects is where OpenCV has it."""

from __future__ import annotations

import itertools
import re
from typing import Any

import cv2
import numpy as np
import pytest

from mirror.dataset.index import build_index
from mirror.dataset.splits import make_split
from mirror.geometry import Camera, project_boxes
from mirror.schema.documents import NovelTraversal
from mirror.schema.files import write_bytes
from mirror.schema.tables import BOXES
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box
from tests.conftest import ROOT

pytest.importorskip("torch")

LENSES = {
    "front_wide": Camera("kannala_brandt", 160, 90, 76.0, 77.0, 79.0, 46.0, (-0.012, 0.004, -0.002, 0.0)),
    "rear": Camera("pinhole", 120, 80, 90.0, 90.0, 61.0, 39.0),
}


@pytest.fixture(scope="module")
def left_behind(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The names that the page's blocks of code leave, run one after another."""
    folder = tmp_path_factory.mktemp("page")
    builder = Builder(folder / "demo" / "dataset", cameras=tuple(LENSES), lenses=LENSES)
    builder.scene("a")
    ego = np.zeros((90, 160), np.uint8)
    ego[80:] = 255
    write_bytes(builder.root / "rigs" / "ego.png", cv2.imencode(".png", ego)[1].tobytes())
    builder.write_rig({"front_wide": "ego.png"})
    for number in range(3):
        start = EPOCH + number * 60 * SECOND
        images = {
            name: cv2.imencode(".jpg", np.full((lens.height_px, lens.width_px, 3), 90 + number, np.uint8))[1].tobytes()
            for name, lens in LENSES.items()
        }
        (traversal,) = builder.drive(f"d{number}", [Pass("a", start, frames=3, images=images)])
        rows = [
            box(start, "near", tx_m=9.0, ty_m=2.0, qw=np.cos(0.2), qz=np.sin(0.2)),
            box(start, "behind", category="van", tx_m=-20.0),
            box(start, "aside", tx_m=14.0, ty_m=-6.0),
        ]
        builder.layer(traversal, "boxes", "petr@1", BOXES, rows)
    build_index(builder.root)
    make_split(builder.root, "novel", NovelTraversal(train=2, held_out=1))
    names: dict[str, Any] = {}
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "loading.md").read_text(), re.DOTALL)
    assert len(blocks) >= 5
    for code in blocks:
        assert code.count("demo/dataset") == ("mirror.open" in code)
        exec(code.replace('"demo/dataset"', repr(str(builder.root))), names)
    return names


def along_edges(frame_SE3_box: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Points (P, 3) on the twelve edges of a box: those between corners of which one sign differs."""
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    corners = (signs * size / 2) @ frame_SE3_box[:3, :3].T + frame_SE3_box[:3, 3]
    edges = [(a, b) for a, b in itertools.combinations(range(8), 2) if (signs[a] != signs[b]).sum() == 1]
    share = np.linspace(0.0, 1.0, 200)[:, None]
    return np.concatenate([corners[a] + share * (corners[b] - corners[a]) for a, b in edges])


def test_the_page_projects_boxes_to_where_opencv_has_them(left_behind: dict[str, Any]) -> None:
    lens, boxes, found = (left_behind[name] for name in ("lens", "boxes", "found"))
    assert boxes.frame == "camera:front_wide" and len(boxes) == 3
    assert dict(zip(boxes.track_id, found.visible.tolist())) == {"near": True, "aside": True, "behind": False}
    matrix = np.array([[lens.fx_px, 0, lens.cx_px - 0.5], [0, lens.fy_px, lens.cy_px - 0.5], [0, 0, 1]])
    for row in np.flatnonzero(found.visible):
        points = along_edges(boxes.pose.matrix()[row], boxes.size_m[row])
        theirs, _ = cv2.fisheye.projectPoints(points[None], np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))
        theirs = theirs[0] + 0.5
        expected = np.concatenate([theirs.min(axis=0), theirs.max(axis=0)])
        assert np.abs(found.bounds_px[row] - expected).max() < 0.05
        outline = left_behind["outlines"][row]
        assert np.abs(np.concatenate([outline.min(axis=0), outline.max(axis=0)]) - expected).max() < 0.05
    near = boxes.pose.translation[boxes.track_id.index("near")]
    # The ego's frame and the camera's: 9 m ahead less 1.5, 2 m left, 0.8 m of 1.6 m high.
    assert np.allclose(near, [-2.0, 0.8, 7.5], atol=1e-6)


def test_the_page_s_sample_projects_boxes_as_the_frame_does(left_behind: dict[str, Any]) -> None:
    train = left_behind["train"]
    frame = train.frames()[0]
    own = frame.boxes("camera:front_wide")
    expected = project_boxes(frame.images["front_wide"].camera_model, own.pose, own.size_m).bounds_px
    assert np.allclose(left_behind["bounds_px"], expected, atol=1e-6, equal_nan=True)
    assert np.isfinite(expected).any()
    assert left_behind["camera"] == LENSES["front_wide"]


def test_the_page_trains_on_what_it_says(left_behind: dict[str, Any]) -> None:
    assert left_behind["checkpoint"]["data"]["epoch"] == 1
    assert tuple(left_behind["images"].shape)[1:] == (3, 90, 160)
    assert left_behind["sample"]["images"].shape == (90, 160, 3)
    assert left_behind["batch"]["images"].shape[1:] == (90, 160, 3)


def test_the_page_lists_every_key_of_a_sample(left_behind: dict[str, Any]) -> None:
    table = (ROOT / "docs" / "loading.md").read_text().partition("### What a sample has")[2].partition("### Options")[0]
    listed = {name for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    assert listed == set(left_behind["sample"])


def test_the_readme_leads_to_the_page() -> None:
    assert "docs/loading.md" in (ROOT / "README.md").read_text()
