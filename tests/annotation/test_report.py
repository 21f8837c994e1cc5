"""The page for review: its order, and what it shows."""

from __future__ import annotations

import json
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
    assert main(["annotate", "report", str(root), "--out", str(page)]) == 2


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
