"""Counts which plates regions cover, by width, and the share of pixels that regions cover beside plates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import cv2
import numpy as np

from benchmarks.plates.held_out import EDGES_PX, HeldOutImage
from benchmarks.privacy.recall import upper_bound
from benchmarks.report import Row
from mirror.arrays import Bool, Float64
from mirror.privacy.operators import Redaction
from mirror.privacy.regions import Region, region_mask

COVERED: Final = 0.9
MISSED_BARS: Final = {192.0: 5.0, 64.0: 10.0}
"""Largest share of missed plates from a width on, in percent."""
OUTSIDE_BAR: Final = 5.0
_GRID: Final = (60, 24)


def covered_shares(corners: Float64, mask: Bool) -> Float64:
    """Return the share (N,) that a mask (H, W) covers of the visible part of plates with corners (N, 4, 2)."""
    along, up = (np.arange(count) + 0.5 for count in _GRID)
    flat = np.stack(np.meshgrid(along / _GRID[0], up / _GRID[1]), axis=-1).reshape(-1, 1, 2).astype(np.float32)
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    shares = []
    for quad in corners:
        matrix = cv2.getPerspectiveTransform(unit, quad.astype(np.float32))
        u, v = np.floor(cv2.perspectiveTransform(flat, matrix)[:, 0]).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < mask.shape[1]) & (v < mask.shape[0])
        shares.append(float(mask[v[inside], u[inside]].mean()) if inside.any() else 0.0)
    return np.array(shares, np.float64)


@dataclass
class PlateTally:
    """Counts in the images of the test.

    Attributes:
        how: margins of the redaction.
        widths_px: width of each plate.
        shares: share of each plate's area that is covered.
        designs: family of each plate.
        outside: share of pixels beside plates that is covered, a value an image.
    """

    how: Redaction = field(default_factory=Redaction)
    widths_px: list[float] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)
    designs: list[str] = field(default_factory=list)
    outside: list[float] = field(default_factory=list)

    def add(self, image: HeldOutImage, regions: Sequence[Region]) -> None:
        """Count an image."""
        height, width = image.image.shape[:2]
        mask = region_mask(regions, self.how.grow, width, height)
        self.widths_px += np.ptp(image.corners[..., 0], axis=1).tolist()
        self.shares += covered_shares(image.corners, mask).tolist()
        self.designs += image.designs
        inside = np.zeros((height, width), np.uint8)
        for box in image.boxes_px.round().astype(int):
            inside[box[1] : box[3] + 1, box[0] : box[2] + 1] = 1
        self.outside.append(float((mask & (inside == 0)).sum() / (inside == 0).sum()))

    def missed(self, low_px: float, high_px: float = np.inf) -> tuple[int, int]:
        """Return the number of plates of a span of widths that are not covered by 90 %, and of all of them."""
        widths, shares = np.array(self.widths_px), np.array(self.shares)
        these = (widths >= low_px) & (widths < high_px)
        return int((shares[these] < COVERED).sum()), int(these.sum())

    def rows(self, name: str) -> Iterator[Row]:
        """Yield the share of missed plates by width with its upper bound, and the area covered beside them."""
        spans = [(low, high, None) for low, high in pairwise(EDGES_PX)]
        for low, high, bar in [*spans, *((low, np.inf, bar) for low, bar in MISSED_BARS.items())]:
            missed, count = self.missed(low, high)
            if count:
                span = f"{low:.0f} px and more" if np.isinf(high) else f"{low:.0f} to {high:.0f} px"
                bound = 100.0 * upper_bound(missed, count)
                share = 100.0 * missed / count
                yield Row(
                    f"{name}, {span}: missed (%)", f"{count} plates", share, bound, unit="% (95 % bound)", bar=bar
                )
        outside = 100.0 * float(np.mean(self.outside))
        yield Row(f"{name}: pixels covered beside plates (%)", f"{len(self.outside)} images", outside, bar=OUTSIDE_BAR)
