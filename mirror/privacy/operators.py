"""Operators that remove what a region shows: what is left are at most 16 values a channel, whatever the resolution.

A blur or a fine mosaic can be inverted by an attacker who knows the operator (see docs/privacy/measurements.md). Here
the irreversible step comes first: a region is reduced to the means of at most 4 x 4 cells, and only these are smoothed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.errors import UsageError
from mirror.privacy.regions import Kind, Region, grown_box

Operator = Literal["fill", "cells"]
MOST_CELLS = 4
_SMALLEST_GROW, _LARGEST_GROW = 0.15, 1.0


@dataclass(frozen=True)
class Redaction:
    """The operators that remove regions, one for each kind.

    Attributes:
        face: operator of faces: `fill` with the mean colour, or `cells`: 4 x 4 means, smoothed.
        plate: operator of number plates; `cells` is refused, as the shapes of four letters survive it.
        grow: share by which a region is enlarged, half on each side.
        feather_px: width of the transition outside of the enlarged region.
        levels: number of levels that a mean is rounded to.
    """

    face: Operator = "cells"
    plate: Operator = "fill"
    grow: float = 0.3
    feather_px: int = 3
    levels: int = 32

    def __post_init__(self) -> None:
        if self.plate != "fill" or self.face not in ("fill", "cells"):
            raise UsageError(
                f"operators {self.face!r} for faces and {self.plate!r} for plates",
                expected="`fill` or `cells` for faces, `fill` for plates",
            )
        if not _SMALLEST_GROW <= self.grow <= _LARGEST_GROW:
            raise UsageError(
                f"regions enlarged by {self.grow}", expected=f"a share from {_SMALLEST_GROW} to {_LARGEST_GROW}"
            )
        if not (0 <= self.feather_px <= 64 and 2 <= self.levels <= 256):
            raise UsageError(
                f"feather_px={self.feather_px}, levels={self.levels}", expected="0 to 64 pixels, and 2 to 256 levels"
            )

    def operator(self, kind: Kind) -> Operator:
        """Return the operator of a kind of region."""
        return self.face if kind == "face" else self.plate


def redact(pixels: UInt8, regions: Iterable[Region], how: Redaction) -> tuple[UInt8, Bool]:
    """Remove regions from an image.

    Every region is computed from the given pixels, so that the order of the regions matters only where they overlap;
    there the later one lies above. The transition to the surroundings lies outside of the enlarged rectangle: no pixel
    inside holds a share of its former value.

    Args:
        pixels: (H, W) or (H, W, C), in any colour space; not changed.
        regions: what is removed.
        how: operators and margins.

    Returns:
        The pixels, and a mask (H, W) of those that differ or may differ: the rectangles and their transitions.
    """
    height, width = pixels.shape[:2]
    boxes = [(box, region) for region in regions if (box := grown_box(region, how.grow, width, height)) is not None]
    result, mask = pixels.copy(), np.zeros((height, width), np.bool_)
    # The transitions come first: the inside of every rectangle is then written over them.
    for (left, top, right, bottom), region in boxes:
        outer = (
            max(left - how.feather_px, 0), max(top - how.feather_px, 0),
            min(right + how.feather_px, width), min(bottom + how.feather_px, height),
        )  # fmt: skip
        part = result[outer[1] : outer[3], outer[0] : outer[2]]
        mask[outer[1] : outer[3], outer[0] : outer[2]] = True
        fill = _replacement(pixels[top:bottom, left:right], how.operator(region.kind), how.levels)
        border = ((top - outer[1], outer[3] - bottom), (left - outer[0], outer[2] - right))
        wide = np.pad(fill, (*border, *((0, 0),) * (fill.ndim - 2)), mode="edge").astype(np.float64)
        weight = _outward_weight(part.shape[:2], border, how.feather_px)
        weight = weight if part.ndim == 2 else weight[..., None]
        part[...] = np.rint(weight * wide + (1.0 - weight) * part).astype(np.uint8)
    for (left, top, right, bottom), region in boxes:
        source = pixels[top:bottom, left:right]
        result[top:bottom, left:right] = _replacement(source, how.operator(region.kind), how.levels)
    return result, mask


def _replacement(part: UInt8, operator: Operator, levels: int) -> UInt8:
    """Make what stands in place of pixels (h, w[, C]), of their means only."""
    cells = 1 if operator == "fill" else MOST_CELLS
    rows, columns = min(cells, part.shape[0]), min(cells, part.shape[1])
    means = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64)
    step = 255.0 / (levels - 1)
    means = (np.rint(means / step) * step).reshape(rows, columns, *part.shape[2:])
    if rows == columns == 1:
        return np.broadcast_to(np.rint(means), part.shape).astype(np.uint8)
    size = (part.shape[1], part.shape[0])
    smooth = cv2.resize(means, size, interpolation=cv2.INTER_LINEAR).reshape(part.shape)
    return np.clip(np.rint(smooth), 0.0, 255.0).astype(np.uint8)


def _outward_weight(
    shape: tuple[int, ...], border: tuple[tuple[int, int], tuple[int, int]], feather_px: int
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Weight (H, W) of the replacement: 1 inside of the border, falling to 0 beyond it."""
    distances = []
    for size, (before, after) in zip(shape[:2], border):
        index = np.arange(size)
        distances.append(np.maximum(np.maximum(before - index, index - (size - 1 - after)), 0))
    distance = np.maximum(distances[0][:, None], distances[1][None])
    return np.asarray(1.0 - distance / (feather_px + 1.0), np.float64)
