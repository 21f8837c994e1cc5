"""Polygons as pixels against rational arithmetic, against their areas, and beside OpenCV's filler."""

from __future__ import annotations

from fractions import Fraction

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.geometry import convex_hull
from mirror.metrics.boxes import clip_to_image, polygon_area, polygon_mask, visible_share
from tests.draws import draws
from tests.metrics.boxes.reference import CAR

BOX = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def mask_by_fractions(polygon: np.ndarray, width: int, height: int) -> np.ndarray:
    """Even-odd rule, every centre against every side, without rounding."""
    points = [(Fraction(float(x)), Fraction(float(y))) for x, y in polygon]
    mask = np.zeros((height, width), dtype=bool)
    for row in range(height):
        y = Fraction(2 * row + 1, 2)
        for column in range(width):
            x, inside = Fraction(2 * column + 1, 2), False
            for (x0, y0), (x1, y1) in zip(points, points[1:] + points[:1]):
                if (y0 <= y) != (y1 <= y):
                    inside ^= x0 + (y - y0) / (y1 - y0) * (x1 - x0) <= x
            mask[row, column] = inside
    return mask


grid = st.integers(-8, 28).map(lambda eighth: eighth / 2.0)
corners = st.lists(st.tuples(grid, grid), min_size=3, max_size=7)


@given(corners)
@example([(0.0, 0.0), (-0.5, -0.5), (12.0, 12.0)])
@settings(max_examples=draws(60), deadline=None)
def test_every_pixel_is_what_rational_arithmetic_says(polygon: list[tuple[float, float]]) -> None:
    np.testing.assert_array_equal(polygon_mask(polygon, 11, 9), mask_by_fractions(np.array(polygon), 11, 9))


@given(corners, st.integers(0, 6), st.booleans())
@settings(max_examples=draws(60), deadline=None)
def test_neither_the_first_corner_nor_the_direction_matters(
    polygon: list[tuple[float, float]], turn: int, back: bool
) -> None:
    other = np.roll(polygon, turn, axis=0)[:: -1 if back else 1]
    np.testing.assert_array_equal(polygon_mask(polygon, 11, 9), polygon_mask(other, 11, 9))


def test_neighbours_share_no_pixel_and_leave_none_out() -> None:
    generator = np.random.default_rng(0)
    for _ in range(200):
        outline = convex_hull(generator.uniform(-5, 45, (12, 2)))
        middle = outline.mean(axis=0)
        parts = [
            polygon_mask([middle, start, end], 40, 40) for start, end in zip(outline, np.roll(outline, -1, axis=0))
        ]
        np.testing.assert_array_equal(np.sum(parts, axis=0), polygon_mask(outline, 40, 40))


def bias(fill, shape: np.ndarray, size: tuple[int, int], count: int) -> float:
    """Mean relative excess of pixels over area, over placements and turns."""
    generator = np.random.default_rng(1)
    total = 0
    for angle, shift in zip(generator.uniform(-0.3, 0.3, count), generator.uniform(0, 1, (count, 2))):
        turned = (shape * size) @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        total += np.count_nonzero(fill(turned - turned.min(axis=0) + 2 + shift))
    return total / (count * polygon_area(shape * size)) - 1


@pytest.mark.parametrize("shape", [BOX, CAR], ids=["box", "car"])
def test_the_area_has_no_bias_where_a_filler_that_draws_the_outline_has_one(shape: np.ndarray) -> None:
    def ours(polygon: np.ndarray) -> np.ndarray:
        return polygon_mask(polygon, 24, 24)

    def theirs(polygon: np.ndarray) -> np.ndarray:
        return cv2.fillConvexPoly(np.zeros((24, 24), np.uint8), np.rint(polygon * 16 - 8).astype(np.int32), 1, 8, 4)

    assert abs(bias(ours, shape, (12, 9), 20_000)) <= 1e-3
    assert bias(theirs, shape, (12, 9), 500) > 0.1


def test_far_outside_without_area_and_tiny() -> None:
    assert polygon_mask([[-1e8, -1e8], [1e8, -1e8], [1e8, 1e8], [-1e8, 1e8]], 5, 4).all()
    assert not polygon_mask(BOX + 1e8, 5, 4).any()
    assert not polygon_mask(BOX - 50.0, 5, 4).any()
    assert not polygon_mask([[1.0, 1.0], [4.0, 3.0]], 5, 4).any()
    assert not polygon_mask([[1.0, 1.0], [2.0, 2.0], [4.0, 4.0]], 5, 4).any()
    assert not polygon_mask([], 5, 4).any()
    assert polygon_mask(BOX * 1e-9 + (2.5, 1.5), 5, 4).sum() == 1
    assert not polygon_mask(BOX * 1e-9 + (2.7, 1.5), 5, 4).any()
    assert polygon_mask(BOX, 0, 4).shape == (4, 0)
    # A pixel's own outline holds that pixel alone, and a shift of half a pixel keeps one.
    assert np.argwhere(polygon_mask(np.add(BOX, (2.5, 1.5)), 5, 4)).tolist() == [[1, 2]]
    assert polygon_mask(np.add(BOX, (2.0, 1.0)), 5, 4).sum() == 1


@pytest.mark.parametrize("corner", [np.nan, np.inf, -np.inf])
def test_a_corner_that_is_not_finite_is_named(corner: float) -> None:
    with pytest.raises(UsageError, match="row 1"):
        polygon_mask([[0.0, 0.0], [corner, 1.0], [1.0, 1.0]], 5, 4)
    with pytest.raises(UsageError, match="shape"):
        polygon_mask(np.zeros((3, 3)), 5, 4)
    with pytest.raises(UsageError, match="raster"):
        polygon_mask(BOX, -1, 4)


def test_areas_and_what_an_image_holds_of_them() -> None:
    assert polygon_area(BOX * (3, 2)) == 6.0
    assert polygon_area(BOX[::-1] * (3, 2) + 1e8) == 6.0
    assert polygon_area([]) == polygon_area([[1.0, 2.0], [3.0, 4.0]]) == 0.0
    assert visible_share(BOX * 10, 20, 20) == 0.25
    assert visible_share(BOX * 10 + 10, 20, 20) == 1.0
    assert visible_share(BOX + 50, 20, 20) == 0.0
    assert np.isnan(visible_share([[1.0, 1.0], [2.0, 2.0]], 20, 20))
    assert polygon_area(clip_to_image(BOX * 1e7, 20, 10)) == pytest.approx(200.0, rel=1e-9)
    assert clip_to_image(BOX + 50, 20, 20).shape == (0, 2)


@given(corners)
@settings(max_examples=draws(60), deadline=None)
def test_clipping_keeps_what_lies_within(points: list[tuple[float, float]]) -> None:
    hull = convex_hull(points)
    clipped = clip_to_image(hull, 11, 9)
    assert ((clipped >= 0) & (clipped <= (11, 9))).all()
    # Shifted off the grid, so that no centre lies on a side.
    shift = (1e-3, 1.7e-3)
    np.testing.assert_array_equal(
        polygon_mask(clip_to_image(hull + shift, 11, 9), 11, 9), polygon_mask(hull + shift, 11, 9)
    )
    wider = polygon_mask((hull + 5) * 8, 8 * 21, 8 * 19)[40 : 40 + 72, 40 : 40 + 88]
    assert polygon_area(clipped) == pytest.approx(wider.sum() / 64, abs=3.0)
