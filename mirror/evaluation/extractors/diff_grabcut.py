"""The region in which two renders differ, cut out along edges by GrabCut (Rother et al., SIGGRAPH 2004)."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from mirror.arrays import Bool, Float32, UInt8

_LEAST_LEVELS: Final = 12.0
_STILL_SHARE: Final = 0.25
_TIMES: Final = 6.0
_LEAST_PX: Final = 16
_KEPT_SHARE: Final = 0.1
_ROUNDS: Final = 4
_SURE: Final = 2.0
_NO_RECTANGLE: Final = (0, 0, 0, 0)


class DiffGrabCut:
    """Differences beyond what the two renders differ by everywhere are seeds; GrabCut finds their outline.

    The threshold is six times what the calmest quarter of the counted pixels differs by at most, 12 levels at least: a
    generator that repaints the whole picture a little is not taken for one edit, and an edit may fill most of a
    picture. Of the pieces that differ, those below a tenth of the largest are left out.
    """

    def extract(self, edited: UInt8, background: UInt8, counted: Bool, name: str) -> Bool:
        """See `Extractor`."""
        difference = _difference(edited, background)
        if not counted.any():
            return np.zeros(counted.shape, np.bool_)
        threshold = max(_TIMES * float(np.quantile(difference[counted], _STILL_SHARE)), _LEAST_LEVELS)
        seeds = _pieces(_closed((difference > threshold) & counted))
        if seeds.sum() < _LEAST_PX:
            return np.zeros(counted.shape, np.bool_)
        sure = seeds & (difference > _SURE * threshold)
        return _pieces(_cut(edited, seeds, sure, counted)) & counted


def _difference(edited: UInt8, background: UInt8) -> Float32:
    """(H, W) largest difference of the channels, of pictures smoothed by a pixel."""
    smooth = [cv2.GaussianBlur(picture, (3, 3), 0.0).astype(np.float32) for picture in (edited, background)]
    return np.asarray(np.abs(smooth[0] - smooth[1]).max(axis=2), np.float32)


def _closed(mask: Bool) -> Bool:
    """Gaps of a pixel or two are filled, single pixels taken away."""
    kernel = np.ones((3, 3), np.uint8)
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel, iterations=2)
    return np.asarray(cv2.morphologyEx(closed, cv2.MORPH_OPEN, kernel) > 0)


def _pieces(mask: Bool) -> Bool:
    """The largest piece and those of at least a tenth of it."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    if count < 2:
        return np.zeros(mask.shape, np.bool_)
    areas = stats[1:, cv2.CC_STAT_AREA]
    kept = 1 + np.flatnonzero(areas >= _KEPT_SHARE * areas.max())
    return np.asarray(np.isin(labels, kept))


def _cut(edited: UInt8, seeds: Bool, sure: Bool, counted: Bool) -> Bool:
    """GrabCut in the surroundings of the seeds; what it cannot tell stays as the difference has it."""
    rows, columns = np.flatnonzero(seeds.any(axis=1)), np.flatnonzero(seeds.any(axis=0))
    margin = 2 + max(rows[-1] - rows[0], columns[-1] - columns[0]) // 4
    part = (
        slice(max(rows[0] - margin, 0), rows[-1] + margin + 1),
        slice(max(columns[0] - margin, 0), columns[-1] + margin + 1),
    )
    near = cv2.dilate(seeds[part].astype(np.uint8), np.ones((3, 3), np.uint8), iterations=2) > 0
    labels: UInt8 = np.full(near.shape, cv2.GC_BGD, np.uint8)
    labels[near & counted[part]] = cv2.GC_PR_BGD
    labels[seeds[part]] = cv2.GC_PR_FGD
    labels[cv2.erode((sure & seeds)[part].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0] = cv2.GC_FGD
    found = seeds.copy()
    known = (labels == cv2.GC_BGD).any() and np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).any()
    if not known:
        return found
    # Its clusters begin at random.
    cv2.setRNGSeed(0)
    picture = np.ascontiguousarray(edited[part][..., ::-1])
    cv2.grabCut(picture, labels, _NO_RECTANGLE, np.zeros((1, 65)), np.zeros((1, 65)), _ROUNDS, cv2.GC_INIT_WITH_MASK)
    cut = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    # Where object and street have the same colours GrabCut may lose the object.
    if 2 * cut.sum() >= seeds[part].sum():
        found[part] = cut
    return found
