"""The training of the detector of plates: samples, which cells find which plate, the loss, and the exported network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.plates.backgrounds import Background, load_backgrounds, save_backgrounds
from benchmarks.plates.fonts import held_out_glyphs, load_glyphs, save_glyphs
from benchmarks.plates.samples import draw_sample
from benchmarks.plates.training.export import export
from benchmarks.plates.training.loss import assign, overlaps, plate_loss
from benchmarks.plates.training.network import STRIDES, PlateNetwork, decode, make_cells


def test_samples_are_functions_of_their_seed_and_fill_the_places_of_plates(tmp_path: Path) -> None:
    street = np.full((720, 1280, 3), 90, np.uint8)
    place = np.array([[600.0, 300.0, 680.0, 320.0]])
    save_backgrounds(tmp_path / "b.npz", [Background(street, place)])
    save_glyphs(tmp_path / "g.npz", held_out_glyphs())
    backgrounds, glyphs = load_backgrounds(tmp_path / "b.npz"), load_glyphs(tmp_path / "g.npz")
    assert (backgrounds[0].places_px == place).all() and np.abs(backgrounds[0].image.astype(int) - 90).max() < 3
    count = 0
    for number in range(4):
        first, again = (draw_sample(glyphs, backgrounds, np.random.default_rng([1, number]), 320) for _ in range(2))
        assert (first.image == again.image).all() and (first.boxes == again.boxes).all()
        assert first.image.shape == (320, 320, 3) and len(first.boxes) == len(first.ignored)
        assert (first.boxes >= 0.0).all() and (first.boxes <= 320.0).all()
        count += len(first.boxes)
    assert count > 2


@pytest.mark.parametrize("width", [13.0, 20.0, 40.0, 90.0, 200.0, 450.0, 620.0])
@pytest.mark.parametrize("aspect", [1.2, 4.7])
def test_every_plate_has_cells_that_find_it(width: float, aspect: float) -> None:
    cells = make_cells(torch.zeros(1, 3, 640, 640))
    assert len(cells) == sum((640 // stride) ** 2 for stride in STRIDES)
    shape = torch.tensor([width, width / aspect])
    for middle in (torch.tensor([320.0, 320.0]), torch.tensor([323.9, 316.2])):
        boxes = torch.cat([middle - 0.5 * shape, middle + 0.5 * shape])[None, None]
        is_plate = torch.ones(1, 1, dtype=torch.bool)
        owner, near, left_out = assign(cells, boxes, is_plate, ~is_plate)
        assert near.any() and not left_out.any() and (owner[near] == 0).all()
        assert not assign(cells, boxes, ~is_plate, is_plate)[1].any()
        assert assign(cells, boxes, ~is_plate, is_plate)[2].any()


def test_the_loss_of_exact_boxes_is_that_of_the_scores() -> None:
    cells = make_cells(torch.zeros(1, 3, 128, 128))
    boxes = torch.tensor([[[40.0, 50.0, 90.0, 66.0]]])
    is_plate = torch.ones(1, 1, dtype=torch.bool)
    near = assign(cells, boxes, is_plate, ~is_plate)[1][0]
    middle, size = torch.tensor([65.0, 58.0]), torch.tensor([50.0, 16.0])
    raw = torch.full((1, len(cells), 5), -20.0)
    raw[0, :, :2] = (middle - cells[:, :2]) / cells[:, 2:]
    raw[0, :, 2:4] = torch.log(size / (4.0 * cells[:, 2:]))
    raw[0, near, 4] = 20.0
    assert decode(raw, cells)[0] == pytest.approx(boxes[0].expand(len(cells), 4), abs=1e-3)
    scores, shapes = plate_loss(raw, cells, boxes, is_plate, ~is_plate)
    assert float(scores) < 1e-6 and float(shapes) < 1e-4
    raw[0, near, 4] = -20.0
    assert float(plate_loss(raw, cells, boxes, is_plate, ~is_plate)[0]) > 1.0
    share, generalised = overlaps(boxes[0], boxes[0] + 100.0)
    assert float(share) == 0.0 and -1.0 < float(generalised) < 0.0


def test_the_exported_network_has_the_outputs_of_the_network(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    torch.manual_seed(0)
    torch.save(PlateNetwork().state_dict(), tmp_path / "plates.pt")
    assert export(tmp_path / "plates.pt", tmp_path / "plates.onnx") < 1e-2
    assert (tmp_path / "plates.onnx").stat().st_size < 5_000_000
