"""Intersection over union in an image: of masks, of boxes along its axes, and of a mask with a projected 3D box."""

from __future__ import annotations

from typing import Any, Final, Literal, TypeAlias, cast, get_args

import numpy as np

from mirror.arrays import AnyArray, Bool, Float64
from mirror.errors import UsageError
from mirror.metrics.boxes.raster import polygon_mask
from mirror.metrics.inputs import Numbers, as_numbers
from mirror.metrics.score import EMPTY_MASK, Score

HullVariant: TypeAlias = Literal["mask_hull", "box_box", "ceiling_normalised"]
HULL_VARIANTS: Final[tuple[HullVariant, ...]] = get_args(HullVariant)


class RegionIou(Score):
    """The overlap of two regions of an image: a float in [0, 1], or NaN without anything to compare.

    Args:
        value: the figure.
        reason: why the value is NaN, or what was empty though the value is 0; None otherwise.
        intersection_px: pixels in both.
        union_px: pixels in either.
        ceiling: what ``intersection_px / union_px`` was divided by.
    """

    intersection_px: int
    union_px: int
    ceiling: float

    def __new__(
        cls,
        value: float,
        reason: str | None = None,
        intersection_px: int = 0,
        union_px: int = 0,
        ceiling: float = 1.0,
    ) -> RegionIou:
        """Set what a float cannot set later."""
        iou = cast(RegionIou, super().__new__(cls, value, reason))
        iou.intersection_px, iou.union_px, iou.ceiling = intersection_px, union_px, ceiling
        return iou

    def __reduce__(self) -> tuple[Any, ...]:
        return RegionIou, (float(self), self.reason, self.intersection_px, self.union_px, self.ceiling)


def mask_iou(first: Numbers, second: Numbers, *, valid: Numbers | None = None) -> RegionIou:
    """Return the intersection over union of two masks.

    Two empty masks, or a ``valid`` that holds no pixel, have no IoU: NaN and the reason. One empty mask beside one that
    is not has an IoU of exactly 0, and the reason names the empty one.

    Args:
        first: (H, W) bool or integer; what is not 0 belongs to the region.
        second: (H, W) likewise.
        valid: (H, W) likewise: the pixels that count; None: all.

    Raises:
        UsageError: shapes differ, or a mask is not two-dimensional, or not bool or integer.
    """
    one, other = as_mask(first, "first mask"), as_mask(second, "second mask")
    _require_alike(one, other)
    if valid is not None:
        counted = as_mask(valid, "valid mask")
        _require_alike(one, counted)
        if not counted.any():
            return RegionIou(EMPTY_MASK, EMPTY_MASK.reason)
        one, other = one & counted, other & counted
    intersection = int(np.count_nonzero(one & other))
    sizes = int(np.count_nonzero(one)), int(np.count_nonzero(other))
    union = sum(sizes) - intersection
    if union == 0:
        return RegionIou(float("nan"), "both masks are empty")
    empty = [name for name, size in zip(("first", "second"), sizes) if size == 0]
    reason = f"the {empty[0]} mask is empty" if empty else None
    return RegionIou(intersection / union, reason, intersection, union)


def box_iou_2d(first: Numbers, second: Numbers) -> Float64:
    """Return the intersection over union of axis-aligned boxes in an image.

    Args:
        first: (..., 4) ``u_min v_min u_max v_max``.
        second: (..., 4) likewise; the shapes broadcast: ``first[:, None], second[None]`` compares each with each.

    Returns:
        (...): NaN where a box has NaN (it is not visible), or where both boxes are without area.

    Raises:
        UsageError: the last axis is not 4, shapes do not broadcast, a number is infinite, or a maximum lies below its
            minimum; the box is named.
    """
    one, other = _boxes(first, "first boxes"), _boxes(second, "second boxes")
    try:
        one, other = np.broadcast_arrays(one, other)
    except ValueError as error:
        raise UsageError(f"boxes of shapes {one.shape} and {other.shape}", expected="shapes that broadcast") from error
    extent_one, extent_other = one[..., 2:] - one[..., :2], other[..., 2:] - other[..., :2]
    overlap = np.minimum(one[..., 2:], other[..., 2:]) - np.maximum(one[..., :2], other[..., :2])
    # Shares of the longer extent: areas of tiny and of huge boxes neither vanish nor overflow.
    unit = np.maximum(extent_one, extent_other)
    with np.errstate(invalid="ignore"):
        shares = [np.prod(np.maximum(side, 0.0) / unit, axis=-1) for side in (overlap, extent_one, extent_other)]
        return np.asarray(shares[0] / (shares[1] + shares[2] - shares[0]))


def hull_iou(
    mask: Numbers,
    hull_px: Numbers,
    *,
    variant: HullVariant = "mask_hull",
    valid: Numbers | None = None,
    silhouette: Numbers | None = None,
) -> RegionIou:
    """Compare a mask with a projected 3D box: the editing accuracy, in three variants.

    All are counted on pixels (`polygon_mask`), within the image and within ``valid``. ``mask_hull``: the mask with
    the box's hull. ``box_box``: the tight upright rectangle of the mask with that of the hull's pixels, so that a mask
    equal to the hull scores 1. ``ceiling_normalised``: the mask with the hull's rectangle, over what the object's own
    outline would reach with it (no car fills its rectangle), at most 1. A rectangle encloses the pixels that count, and
    pixels within it that do not count are left out.

    A hull without a pixel that counts is no target: NaN and the reason. An empty mask beside a target scores 0, and the
    reason says so.

    Args:
        mask: (H, W) bool or integer, the region found in the image.
        hull_px: (K, 2) the convex outline of the projected box, from `mirror.geometry.BoxProjections.hull`.
        variant: one of `HULL_VARIANTS`.
        valid: (H, W) the pixels that count, without the ego body and nearer objects, say; None: all.
        silhouette: (H, W) the object's true outline at the target for the ceiling, cut by ``valid`` as the mask is;
            None: the hull stands for it.

    Raises:
        UsageError: the variant is unknown, masks do not fit, a corner is not finite, or a silhouette is given to a
            variant that has no ceiling.
    """
    if variant not in HULL_VARIANTS:
        raise UsageError(f"variant {variant!r} of the hull's IoU", expected=" | ".join(HULL_VARIANTS))
    if silhouette is not None and variant != "ceiling_normalised":
        raise UsageError(
            f"a silhouette for variant {variant!r}", expected="none: only ceiling_normalised has a ceiling"
        )
    found = as_mask(mask, "mask")
    target = polygon_mask(hull_px, found.shape[1], found.shape[0])
    counted = np.ones_like(found) if valid is None else as_mask(valid, "valid mask")
    _require_alike(found, counted)
    found, target = found & counted, target & counted
    if not target.any():
        return RegionIou(float("nan"), "the target box holds no pixel that counts")
    rectangle = _rectangle(target) & counted
    if not found.any():
        region = target if variant == "mask_hull" else rectangle
        return RegionIou(0.0, "the mask is empty", 0, int(np.count_nonzero(region)))
    if variant == "mask_hull":
        return mask_iou(found, target)
    if variant == "box_box":
        return mask_iou(_rectangle(found) & counted, rectangle)
    ideal = target if silhouette is None else as_mask(silhouette, "silhouette")
    _require_alike(found, ideal)
    return _normalised(found, rectangle, ideal & counted)


def as_mask(mask: Numbers, what: str) -> Bool:
    """Check a mask (H, W) and return it: bool, or integers that are not 0 for selected pixels.

    Raises:
        UsageError: it is not two-dimensional, or not bool or integer.
    """
    given = as_numbers(mask, what)
    if given.ndim != 2 or not (given.dtype == np.bool_ or np.issubdtype(given.dtype, np.integer)):
        raise UsageError(
            f"{what} of shape {given.shape} and type {given.dtype}",
            expected="(H, W), bool or integer",
            remedy="compare scores with a threshold first",
        )
    return given.astype(np.bool_, copy=False)


def _normalised(found: Bool, rectangle: Bool, ideal: Bool) -> RegionIou:
    ceiling, plain = mask_iou(ideal, rectangle), mask_iou(found, rectangle)
    if ceiling == 0.0:
        return RegionIou(float("nan"), "the silhouette shares no pixel with the target")
    return RegionIou(min(plain / ceiling, 1.0), None, plain.intersection_px, plain.union_px, float(ceiling))


def _rectangle(mask: Bool) -> Bool:
    """The pixels of a mask's tight upright rectangle."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    filled = np.zeros_like(mask)
    if len(rows):
        filled[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = True
    return filled


def _boxes(boxes: Numbers, what: str) -> Float64:
    given = as_numbers(boxes, what, np.float64)
    if given.ndim == 0 or given.shape[-1] != 4:
        raise UsageError(f"{what} of shape {given.shape}", expected="(..., 4): u_min v_min u_max v_max")
    # NaN is a box that is not visible.
    wrong = np.isinf(given).any(axis=-1) | (given[..., 2:] < given[..., :2]).any(axis=-1)
    if wrong.any():
        row = tuple(int(index) for index in np.argwhere(wrong)[0])
        raise UsageError(
            f"box {given[row].tolist()}",
            place=f"{what}, {row}",
            expected="finite numbers u_min <= u_max, v_min <= v_max",
        )
    return given


def _require_alike(one: AnyArray, other: AnyArray) -> None:
    if one.shape != other.shape:
        raise UsageError(f"masks of shapes {one.shape} and {other.shape}", expected="one shape")
