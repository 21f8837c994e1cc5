"""Synthetic plates of the benchmark: exact corners, what counts as covered, and what no training has."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.plates.backgrounds import Background
from benchmarks.plates.designs import FAMILIES, HELD_OUT
from benchmarks.plates.drawing import Panel
from benchmarks.plates.fonts import held_out_fonts, held_out_glyphs
from benchmarks.plates.geometry import Stance, paste, place_corners
from benchmarks.plates.held_out import EDGES_PX, draw_held_out
from benchmarks.plates.recall import PlateTally, covered_shares
from mirror.privacy.regions import region_at


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (30.0, 10.0, -6.0), (-60.0, 0.0, 5.0)])
def test_a_plate_lies_where_its_corners_say(turn: tuple[float, float, float]) -> None:
    stance = Stance(301.3, (402.7, 305.2), *turn)
    corners = place_corners(stance, 4.6, 914.0, 1.0)
    assert np.ptp(corners[:, 0]) == pytest.approx(301.3)
    white = np.full((100, 460, 3), 255, np.uint8)
    panel = Panel(white, np.full((100, 460), 255, np.uint8), (0.0, 0.0, 460.0, 100.0))
    image = np.zeros((600, 800, 3), np.uint8)
    paste(image, panel, corners, np.ones(3, np.float32), 1.0)
    # The area and the middle of what is white agree with those of the exact corners.
    share = image[..., 0] / 255.0
    v, u = np.indices(share.shape) + 0.5
    assert share.sum() == pytest.approx(cv2.contourArea(corners.astype(np.float32)), rel=0.02)
    moments = cv2.moments(corners.astype(np.float32))
    middle = moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]
    assert ((share * u).sum() / share.sum(), (share * v).sum() / share.sum()) == pytest.approx(middle, abs=0.3)


def test_the_covered_share_is_that_of_the_area() -> None:
    quad = np.array([[[100.0, 100.0], [300.0, 100.0], [300.0, 150.0], [100.0, 150.0]]])
    mask = np.zeros((200, 400), np.bool_)
    mask[:, :250] = True
    assert covered_shares(quad, mask).tolist() == pytest.approx([0.75], abs=0.01)
    # The part of a plate that lies outside of the image does not count.
    assert covered_shares(quad + np.array([250.0, 0.0]), ~mask).tolist() == [1.0]


def test_held_out_images_have_every_width_and_nothing_of_the_training() -> None:
    assert not {one.name for one in HELD_OUT} & {one.name for one in FAMILIES}
    assert not {one.size_mm + one.rows for one in HELD_OUT} & {one.size_mm + one.rows for one in FAMILIES}
    assert all("DejaVu" not in name and "Roboto" not in name for name in held_out_fonts())
    street = Background(np.full((720, 1280, 3), 120, np.uint8), np.zeros((0, 4)))
    tally, count = PlateTally(), 8
    for image in draw_held_out(count, [street], held_out_glyphs()):
        boxes = image.boxes_px
        assert (boxes >= 0.0).all() and (boxes <= [1280, 720, 1280, 720]).all()
        tally.add(image, [region_at(box, "plate") for box in boxes[:1]])
    widths = np.array(tally.widths_px)
    assert set(np.digitize(widths, EDGES_PX)) == set(range(1, len(EDGES_PX)))
    missed, plates = tally.missed(0.0)
    assert plates == len(widths) and missed == plates - count
    again = next(iter(draw_held_out(4, [street], held_out_glyphs(), left_out=range(3))))
    last = list(draw_held_out(4, [street], held_out_glyphs()))[3]
    assert (again.image == last.image).all() and again.light == "night"
