"""Tests of faces and plates of the synthetic street: their boxes, and their detection by detectors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.synth_detectors.crowd import CrowdImage, Target, build_street, make_condition, render_crowds
from benchmarks.synth_detectors.detectors import AgentPlates, YuNet, box_overlaps, evaluate_detections, make_anchors
from mirror.errors import UsageError


@pytest.fixture(scope="module")
def images() -> list[CrowdImage]:
    return list(render_crowds(build_street(), make_condition("day", "clear"), 2, 640, 1))


def target(box: tuple[float, float, float, float], seen: float = 1.0) -> Target:
    return Target(np.array(box), seen)


def test_overlaps_match_the_closed_form() -> None:
    boxes = np.array([[0.0, 0.0, 4.0, 2.0], [10.0, 10.0, 11.0, 11.0]])
    others = np.array([[2.0, 0.0, 6.0, 2.0], [0.0, 0.0, 4.0, 2.0]])
    assert box_overlaps(boxes, others) == pytest.approx(np.array([[4.0 / 12.0, 1.0], [0.0, 0.0]]))
    assert box_overlaps(np.zeros((0, 4)), others).shape == (0, 2)


def test_hardly_visible_targets_are_optional() -> None:
    boxes = np.array([[0.0, 0.0, 10.0, 10.0], [50.0, 50.0, 60.0, 60.0], [90.0, 0.0, 99.0, 9.0]])
    targets = [target((1.0, 0.0, 11.0, 10.0)), target((50.0, 50.0, 60.0, 60.0), 0.3), target((30.0, 0.0, 38.0, 20.0))]
    result = evaluate_detections([(boxes, targets), (np.zeros((0, 4)), [])], 1, 0.6)
    assert result.size_px.tolist() == [10.0, 20.0]
    assert result.found.tolist() == [True, False]
    assert (result.boxes, result.right) == (3, 2)


def test_number_of_anchors_equals_the_network_outputs() -> None:
    centre, size = make_anchors(540, 960)
    assert centre.shape == size.shape == (21420, 2)
    assert centre[0].tolist() == [4.0, 4.0]
    assert sorted(set(size[:, 0])) == [24.0, 48.0, 96.0, 192.0, 384.0, 768.0]


def test_weights_with_another_hash_are_refused(tmp_path: Path) -> None:
    weights = tmp_path / "clp_det.onnx"
    weights.write_bytes(b"something else")
    with pytest.raises(UsageError, match="sha256"):
        AgentPlates(weights)


def test_images_show_people_and_cars_from_the_front(images: list[CrowdImage]) -> None:
    people, cars = images
    assert sum(face.seen > 0.6 for face in people.faces) >= 3
    assert sum(plate.seen > 0.85 for plate in cars.plates) >= 1
    for face in people.faces:
        assert 0.0 < face.seen <= 1.0
        if face.seen > 0.9:
            wide, high = face.size_px
            assert 0.5 < wide / high < 1.2
    for plate in cars.plates:
        if plate.seen > 0.85:
            assert plate.size_px[0] < 7.0 * plate.size_px[1]


def test_yunet_finds_clear_faces(images: list[CrowdImage], real_data: Path) -> None:
    detector = YuNet(real_data / "weights" / "yunet" / "yunet_n_dynamic.onnx")
    found = evaluate_detections([(detector.boxes(one.bgr), one.faces) for one in images], 1, 0.6)
    clear = found.size_px >= 20.0
    assert clear.sum() >= 2
    assert found.found[clear].mean() >= 0.8
    assert found.right >= 0.8 * found.boxes
