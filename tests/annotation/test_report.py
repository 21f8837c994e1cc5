"""The page for review: its order, and what it shows."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.annotation import Detections, annotate
from mirror.annotation.ranking import count_unmatched, rank_frames
from mirror.cli.main import main
from mirror.dataset.frames import Frame
from mirror.geometry import Poses
from mirror.view.birds_eye import draw_from_above
from tests.annotation.known import Known, truth


class Other(Known):
    """As `Known`, but one box is elsewhere in frame 1, and a box is missing in frame 2."""

    fingerprint = "other"

    def annotate(self, frame: Frame) -> Detections:
        found = truth(frame)
        if frame.frame_index == 1:
            place = found.ego_SE3_box.translation + np.array([[5.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
            return replace(found, ego_SE3_box=Poses(found.ego_SE3_box.rotation, place))
        return found[[0]] if frame.frame_index == 2 else found


def test_frames_of_disagreement_come_first(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    annotate(mirror.open(root), Known())
    annotate(mirror.open(root), Other(), source="other")
    ranks = rank_frames(mirror.open(root), "known@1", "other@1")
    assert [rank.unmatched for rank in ranks] == [2, 2, 1, 1, 0, 0, 0]
    page = tmp_path / "review.html"
    words = ["annotate", "report", str(root), "--boxes", "known@1", "--against", "other@1", "--frames", "3"]
    assert main([*words, "--out", str(page), "--json"]) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (report["frames"], report["worst"]["unmatched"]) == (3, 2)
    text = page.read_text()
    # Three frames with the images of two cameras each, and boxes over them.
    assert text.count("<h2>") == 3
    assert text.count("data:image/jpeg") == 6
    assert "2 boxes without a partner" in text
    # Both layers are drawn, the second one dashed: in frame 1 two boxes each, of which one is elsewhere.
    assert "solid: known@1" in text and "dashed: other@1" in text and ".against path{stroke-dasharray" in text
    overlays = [
        re.match('<g class="against">(.*?)</g>(.*?)</svg>', part, re.DOTALL)
        for part in re.split('<svg class="boxes"[^>]*>', text)[1:]
    ]
    drawn = [[re.findall(' d="([^"]*)"', layer) for layer in overlay.groups()] for overlay in overlays if overlay]
    assert len(drawn) == 6 and any(dashed and solid and dashed != solid for dashed, solid in drawn)
    assert "Doubt is the sum of 1 - score" in text
    assert main(["annotate", "report", str(root), "--out", str(page)]) == 2


class Aside(Known):
    """As `Known`, with the first box half a metre to the left."""

    fingerprint = "aside"

    def annotate(self, frame: Frame) -> Detections:
        found = truth(frame)
        place = found.ego_SE3_box.translation + np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
        return replace(found, ego_SE3_box=Poses(found.ego_SE3_box.rotation, place))


def test_shifts_in_the_images_are_those_of_the_pinhole(root: Path) -> None:
    annotate(mirror.open(root), Known())
    annotate(mirror.open(root), Aside(), source="aside")
    dataset = mirror.open(root)
    ranks = {(rank.traversal_id, rank.timestamp_ns): rank for rank in rank_frames(dataset, "known@1", "aside@1")}
    seen = 0
    for frame in dataset.frames():
        largest = 0.0
        for image in frame.images.values():
            camera = image.camera_model
            assert camera.model == "pinhole"
            matrix = (frame.world_SE3_ego.inverse() @ image.world_SE3_camera).inverse().matrix()[0]
            place = truth(frame).ego_SE3_box.translation[0]
            one, other = (matrix[:3, :3] @ np.add(place, (0.0, aside, 0.0)) + matrix[:3, 3] for aside in (0.0, 0.5))
            if min(one[2], other[2]) <= 0.0:
                continue
            u, v = (camera.fx_px * one[0] / one[2] + camera.cx_px, camera.fy_px * one[1] / one[2] + camera.cy_px)
            there = np.array(
                (camera.fx_px * other[0] / other[2] + camera.cx_px, camera.fy_px * other[1] / other[2] + camera.cy_px)
            )
            if 0.0 <= u <= camera.width_px and 0.0 <= v <= camera.height_px:
                largest = max(largest, float(np.linalg.norm(there - (u, v))) / camera.width_px)
        rank = ranks[frame.traversal_id, frame.timestamp_ns]
        assert rank.unmatched == 0
        assert rank.shift == pytest.approx(largest, abs=1e-4)
        seen += largest > 0.0
    assert seen >= 4


def test_the_view_from_above_has_boxes_where_they_are(root: Path) -> None:
    annotate(mirror.open(root), Known())
    dataset = mirror.open(root).with_layers(boxes="known@1")
    images = list(draw_from_above(dataset, dataset.traversals()[0], range_m=20.0, size_px=400))
    assert len(images) == 4
    for number, image in enumerate(images):
        # Ten pixels a metre: the middle of the car is 8 + number metres ahead and 2 m to the left.
        row, column = 200 - 10 * (8 + number), 180
        colour = image[row, column].astype(int)
        assert colour[2] > colour[0] + 60
        assert (image[row, 400 - column] == image[100, 20]).all()
    with_other = next(draw_from_above(dataset, dataset.traversals()[0], "known@1", range_m=20.0, size_px=400))
    # The first layer lies above the grey one.
    assert with_other[120, 180, 2] > with_other[120, 180, 0].astype(int) + 60


def test_the_report_writes_a_video(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    av = pytest.importorskip("av")
    annotate(mirror.open(root), Known())
    video = tmp_path / "above.mp4"
    words = ["annotate", "report", str(root), "--boxes", "known@1", "--out", str(tmp_path / "review.html"), "--json"]
    assert main([*words, "--video", str(video)]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["video"] == str(video)
    with av.open(str(video)) as container:
        assert sum(1 for _ in container.decode(video=0)) in (3, 4)


def test_boxes_without_a_partner_are_counted_once() -> None:
    rotation = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)

    def at(*x: float, category: str = "car") -> Detections:
        count = len(x)
        centre = np.array([(value, 0.0, 0.0) for value in x])
        return Detections(
            0, Poses(rotation[:count], centre), np.ones((count, 3)), np.full((count, 3), np.nan), (category,) * count,
            np.ones(count),
        )  # fmt: skip

    assert count_unmatched(at(0.0, 1.0), at(0.5)) == 1
    assert count_unmatched(at(0.0), at(3.0)) == 2
    assert count_unmatched(at(0.0), at(0.0, category="pedestrian")) == 2
    assert count_unmatched(at(0.0), Detections.empty(0)) == 1
