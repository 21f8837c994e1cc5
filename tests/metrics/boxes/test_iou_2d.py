"""Overlaps in the image against counts, closed forms and properties."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mirror.errors import UsageError
from mirror.geometry import Camera, Poses, project_boxes
from mirror.metrics.boxes import HULL_VARIANTS, box_iou_2d, hull_iou, mask_iou, polygon_mask, visible_share
from tests.draws import draws

SQUARE = np.array([[2.0, 1.0], [8.0, 1.0], [8.0, 6.0], [2.0, 6.0]])
HEXAGON = np.array([[20.0, 14.0], [34.0, 10.0], [60.0, 12.0], [61.0, 30.0], [48.0, 36.0], [21.0, 33.0]])
masks = hnp.arrays(np.bool_, (5, 6))


@given(masks, masks)
def test_mask_iou_is_the_share_of_two_sets(first: np.ndarray, second: np.ndarray) -> None:
    one, other = ({tuple(pixel) for pixel in np.argwhere(mask)} for mask in (first, second))
    result = mask_iou(first, second)
    assert (result.intersection_px, result.union_px) == (len(one & other), len(one | other))
    assert mask_iou(second, first) == result or np.isnan(result)
    if one | other:
        assert result == len(one & other) / len(one | other)
    else:
        assert np.isnan(result)
        assert result.reason == "both masks are empty"


def test_empty_masks_say_so() -> None:
    empty, full = np.zeros((4, 4), dtype=bool), np.ones((4, 4), dtype=bool)
    assert mask_iou(empty, full) == 0.0
    assert mask_iou(empty, full).reason == "the first mask is empty"
    assert mask_iou(full, empty).reason == "the second mask is empty"
    assert mask_iou(full, full).reason is None
    none = mask_iou(full, full, valid=empty)
    assert np.isnan(none)
    assert pickle.loads(pickle.dumps(none)).reason == none.reason
    assert none.reason == "the mask selects no pixel"


def test_masks_of_one_pixel_and_of_other_types() -> None:
    one = np.zeros((3, 3), dtype=np.uint8)
    one[1, 1] = 255
    assert mask_iou(one, one.astype(bool)) == 1.0
    assert mask_iou(one, np.roll(one, 1)) == 0.0
    valid = np.ones((3, 3), dtype=np.int64)
    valid[0] = 0
    assert mask_iou(np.ones((3, 3), bool), one, valid=valid) == 1 / 6
    for wrong in (one.astype(float), one[0], np.zeros((3, 3, 3), bool)):
        with pytest.raises(UsageError, match="first mask"):
            mask_iou(wrong, one)
    with pytest.raises(UsageError, match="shapes"):
        mask_iou(one, one[:2])
    with pytest.raises(UsageError, match="shapes"):
        mask_iou(one, one, valid=one[:2])


def boxes_2d(low: float = -100.0, high: float = 100.0) -> st.SearchStrategy[np.ndarray]:
    side = st.tuples(st.floats(low, high), st.floats(1e-3, 50.0))
    return st.tuples(side, side).map(
        lambda sides: np.array([sides[0][0], sides[1][0], sides[0][0] + sides[0][1], sides[1][0] + sides[1][1]])
    )


@given(boxes_2d(), boxes_2d(), st.floats(-1e3, 1e3))
def test_box_iou_2d_is_symmetric_bounded_and_moves_along(first: np.ndarray, second: np.ndarray, shift: float) -> None:
    value = box_iou_2d(first, second)
    assert 0.0 <= value <= 1.0
    assert box_iou_2d(second, first) == value
    assert box_iou_2d(first, first) == 1.0
    assert box_iou_2d(first + shift, second + shift) == pytest.approx(float(value), abs=1e-8)


def test_box_iou_2d_in_closed_form() -> None:
    box = np.array([0.0, 0.0, 2.0, 1.0])
    others = np.array([[1, 0, 3, 1], [2, 0, 4, 1], [0, 0, 2, 1], [5, 5, 6, 6], [0.5, 0.25, 1.5, 0.75]], dtype=float)
    expected = np.array([1 / 3, 0.0, 1.0, 0.0, 0.25])
    np.testing.assert_allclose(box_iou_2d(box, others), expected, rtol=1e-15)
    np.testing.assert_array_equal(box_iou_2d(others[:, None], others[None]).diagonal(), np.ones(5))
    # Powers of two, so that an offset rounds nothing; and sizes whose areas neither vanish nor overflow.
    np.testing.assert_allclose(box_iou_2d(box + 2.0**27, others + 2.0**27), expected, rtol=1e-15)
    for scale in (1e-300, 1e-160, 1e160, 1e300):
        np.testing.assert_allclose(box_iou_2d(box * scale, others * scale), expected, rtol=1e-14)


def test_box_iou_2d_of_what_is_no_box() -> None:
    point, line, box = [1.0, 1.0, 1.0, 1.0], [0.0, 1.0, 2.0, 1.0], [0.0, 0.0, 2.0, 2.0]
    assert box_iou_2d(point, box) == 0.0
    assert box_iou_2d(line, box) == 0.0
    assert np.isnan(box_iou_2d(point, point))
    assert np.isnan(box_iou_2d(line, line))
    assert np.isnan(box_iou_2d([np.nan] * 4, box))
    assert box_iou_2d(np.empty((0, 4)), box).shape == (0,)
    for wrong in ([0.0, 0.0, np.inf, 1.0], [0.0, 0.0, -1.0, 1.0]):
        with pytest.raises(UsageError, match=r"second boxes, \(1,\)"):
            box_iou_2d(box, [box, wrong])
    with pytest.raises(UsageError, match="4"):
        box_iou_2d([0.0, 1.0, 2.0], box)
    with pytest.raises(UsageError, match="broadcast"):
        box_iou_2d(np.tile(box, (2, 1)), np.tile(box, (3, 1)))


@pytest.mark.parametrize("variant", HULL_VARIANTS)
def test_a_mask_that_is_the_hull_scores_one_in_every_variant(variant: str) -> None:
    result = hull_iou(polygon_mask(HEXAGON, 80, 50), HEXAGON, variant=variant)
    assert result == 1.0
    assert result.reason is None


def test_the_variants_in_closed_form() -> None:
    # The target is 6 x 5 pixels, the mask its left half and one column beside it: 4 columns, 3 of them within.
    mask = np.zeros((10, 12), dtype=bool)
    mask[1:6, 1:5] = True
    assert hull_iou(mask, SQUARE) == 15 / 35
    assert hull_iou(mask, SQUARE, variant="box_box") == 15 / 35
    # Only the mask's diagonal: its rectangle stays, its pixels go.
    diagonal = mask & np.eye(10, 12, dtype=bool)
    assert hull_iou(diagonal, SQUARE) == 3 / 31
    assert hull_iou(diagonal, SQUARE, variant="box_box") == 12 / 34
    # An object that fills half its rectangle cannot reach more than one half with it.
    half = np.zeros_like(mask)
    half[1:6, 2:5] = True
    normalised = hull_iou(mask, SQUARE, variant="ceiling_normalised", silhouette=half)
    assert normalised.ceiling == 0.5
    assert normalised == pytest.approx(15 / 35 / 0.5)
    assert hull_iou(half, SQUARE, variant="ceiling_normalised", silhouette=half) == 1.0
    # What fills the rectangle better than the object can is not better than the object.
    full = polygon_mask(SQUARE, 12, 10)
    assert hull_iou(full, SQUARE, variant="ceiling_normalised", silhouette=half) == 1.0
    assert hull_iou(mask, HEXAGON - (18, 9), variant="ceiling_normalised").ceiling < 1.0


@pytest.mark.parametrize("variant", HULL_VARIANTS)
def test_no_target_is_not_a_score_and_no_mask_is_zero(variant: str) -> None:
    mask, nothing = np.ones((10, 12), dtype=bool), np.zeros((10, 12), dtype=bool)
    for hull in (SQUARE + 100.0, np.empty((0, 2)), SQUARE[:2]):
        gone = hull_iou(mask, hull, variant=variant)
        assert np.isnan(gone)
        assert gone.reason == "the target box holds no pixel that counts"
    assert np.isnan(hull_iou(mask, SQUARE, variant=variant, valid=nothing))
    empty = hull_iou(nothing, SQUARE, variant=variant)
    assert (empty, empty.reason) == (0.0, "the mask is empty")
    nearer = mask.copy()
    nearer[:, :5] = False
    assert hull_iou(polygon_mask(SQUARE, 12, 10) & nearer, SQUARE, variant=variant, valid=nearer) == 1.0


def bounding(pixels: set[tuple[int, int]], counted: set[tuple[int, int]]) -> set[tuple[int, int]]:
    """Pixels that count within the bounding rectangle of some."""
    if not pixels:
        return set()
    (top, left), (bottom, right) = map(min, zip(*pixels)), map(max, zip(*pixels))
    return {(row, column) for row, column in counted if top <= row <= bottom and left <= column <= right}


@given(hnp.arrays(np.bool_, (10, 12)), hnp.arrays(np.bool_, (10, 12)), hnp.arrays(np.bool_, (10, 12)))
@settings(max_examples=draws(40), deadline=None)
def test_only_pixels_of_valid_count_in_every_variant(mask: np.ndarray, valid: np.ndarray, outline: np.ndarray) -> None:
    counted, found, hull, ideal = (
        {(int(row), int(column)) for row, column in np.argwhere(region & valid)}
        for region in (valid, mask, polygon_mask(SQUARE, 12, 10), outline)
    )
    rectangle = bounding(hull, counted)
    pairs = {"mask_hull": (found, hull), "box_box": (bounding(found, counted), rectangle)}
    for variant in HULL_VARIANTS:
        silhouette = outline if variant == "ceiling_normalised" else None
        result = hull_iou(mask, SQUARE, variant=variant, valid=valid, silhouette=silhouette)
        one, other = pairs.get(variant, (found, rectangle))
        assert result.union_px <= len(counted)
        if not hull or (found and silhouette is not None and not ideal & rectangle):
            assert np.isnan(result)
            continue
        assert (result.intersection_px, result.union_px) == (len(one & other), len(one | other))
        ceiling = len(ideal & rectangle) / len(ideal | rectangle) if found and silhouette is not None else 1.0
        assert result == min(len(one & other) / len(one | other) / ceiling, 1.0)


def test_what_a_hull_cannot_be_asked() -> None:
    mask = np.ones((10, 12), dtype=bool)
    with pytest.raises(UsageError, match="mask_hull"):
        hull_iou(mask, SQUARE, variant="aabb")
    with pytest.raises(UsageError, match="silhouette"):
        hull_iou(mask, SQUARE, silhouette=mask)
    with pytest.raises(UsageError, match="row 0"):
        hull_iou(mask, SQUARE * np.nan)
    apart = np.zeros_like(mask)
    apart[9, 11] = True
    result = hull_iou(mask, SQUARE, variant="ceiling_normalised", silhouette=apart)
    assert np.isnan(result)
    assert "silhouette" in str(result.reason)


@given(st.floats(-8.0, 8.0), st.floats(-3.0, 25.0), st.floats(-np.pi, np.pi))
@settings(max_examples=draws(40), deadline=None)
def test_a_cars_hull_is_what_rays_see_even_through_the_near_plane(x: float, z: float, yaw: float) -> None:
    # No ray of a pixel centre runs along a box side.
    camera = Camera("pinhole", 96, 54, 55.113, 55.271, 48.0137, 27.0291)
    # The car's z axis points up, against the camera's y; then it turns.
    upright = Poses([[0.5, 0.5, -0.5, 0.5]], [[x, 1.0, z]])
    pose = upright.compose(Poses([[np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]], [[0.0, 0.0, 0.0]]))
    lwh = np.array([[4.5, 1.9, 1.5]])
    hull = project_boxes(camera, pose, lwh).hull(0)
    turned = pose.inverse()
    rays = camera.rays().direction.reshape(-1, 3)
    direction, origin = turned.transform(rays)[0] - turned.translation, turned.translation[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-lwh[0] / 2 - origin) / direction, (lwh[0] / 2 - origin) / direction
    enter, leave = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
    seen = ((leave >= enter) & (leave * rays[:, 2] >= 0.1)).reshape(54, 96)
    assert np.count_nonzero(polygon_mask(hull, 96, 54) != seen) <= 1
    if seen.any():
        assert hull_iou(seen, hull) > 0.9 or seen.sum() < 12
        assert 0.0 < visible_share(hull, 96, 54) <= 1.0
