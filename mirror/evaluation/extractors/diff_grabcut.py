"""The region in which two renders differ, refined along image edges by GrabCut (Rother et al., SIGGRAPH 2004)."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from mirror.arrays import Bool, Float32, UInt8

_MIN_THRESHOLD_LEVELS: Final = 12.0
_NOISE_QUANTILE: Final = 0.25
_NOISE_FACTOR: Final = 6.0
_MIN_REGION_PX: Final = 16
_MIN_COMPONENT_SHARE: Final = 0.1
_ITERATIONS: Final = 4
_FOREGROUND_FACTOR: Final = 2.0
_NO_RECTANGLE: Final = (0, 0, 0, 0)


class DiffGrabCut:
    """An extractor whose seeds are pixels with a large difference between the renders; GrabCut finds the outline.

    The threshold is six times the 25 % quantile of the difference over the counted pixels, and at least 12 levels.
    Therefore a generator that changes the whole image a little does not count as one edit, and an edit may fill most of
    an image. Connected components smaller than a tenth of the largest are left out.
    """

    identity: Final = "diff-grabcut"

    def extract(self, edited: UInt8, background: UInt8, counted: Bool, name: str) -> Bool:
        """See `Extractor`."""
        difference = _difference(edited, background)
        if not counted.any():
            return np.zeros(counted.shape, np.bool_)
        noise = float(np.quantile(difference[counted], _NOISE_QUANTILE))
        threshold = max(_NOISE_FACTOR * noise, _MIN_THRESHOLD_LEVELS)
        seeds = _keep_large_components(_clean_mask((difference > threshold) & counted))
        if seeds.sum() < _MIN_REGION_PX:
            return np.zeros(counted.shape, np.bool_)
        foreground = seeds & (difference > _FOREGROUND_FACTOR * threshold)
        return _keep_large_components(_run_grabcut(edited, seeds, foreground, counted)) & counted

    def fingerprint(self, name: str) -> str:
        """Return an empty hash: the mask depends on the renders alone."""
        return ""


def _difference(edited: UInt8, background: UInt8) -> Float32:
    """(H, W) largest difference over the channels, after a 3 x 3 Gaussian blur of both images."""
    smooth = [cv2.GaussianBlur(image, (3, 3), 0.0).astype(np.float32) for image in (edited, background)]
    return np.asarray(np.abs(smooth[0] - smooth[1]).max(axis=2), np.float32)


def _clean_mask(mask: Bool) -> Bool:
    """Fill gaps of one or two pixels, and remove single pixels."""
    kernel = np.ones((3, 3), np.uint8)
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel, iterations=2)
    return np.asarray(cv2.morphologyEx(closed, cv2.MORPH_OPEN, kernel) > 0)


def _keep_large_components(mask: Bool) -> Bool:
    """Keep the largest connected component and those with at least a tenth of its area."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    if count < 2:
        return np.zeros(mask.shape, np.bool_)
    areas = stats[1:, cv2.CC_STAT_AREA]
    kept = 1 + np.flatnonzero(areas >= _MIN_COMPONENT_SHARE * areas.max())
    return np.asarray(np.isin(labels, kept))


def _run_grabcut(edited: UInt8, seeds: Bool, foreground: Bool, counted: Bool) -> Bool:
    """Run GrabCut around the seeds; the seeds are returned if GrabCut cannot start or loses most of them."""
    rows, columns = np.flatnonzero(seeds.any(axis=1)), np.flatnonzero(seeds.any(axis=0))
    margin = 2 + max(rows[-1] - rows[0], columns[-1] - columns[0]) // 4
    part = (
        slice(max(rows[0] - margin, 0), rows[-1] + margin + 1),
        slice(max(columns[0] - margin, 0), columns[-1] + margin + 1),
    )
    surroundings = cv2.dilate(seeds[part].astype(np.uint8), np.ones((3, 3), np.uint8), iterations=2) > 0
    labels: UInt8 = np.full(surroundings.shape, cv2.GC_BGD, np.uint8)
    labels[surroundings & counted[part]] = cv2.GC_PR_BGD
    labels[seeds[part]] = cv2.GC_PR_FGD
    labels[cv2.erode((foreground & seeds)[part].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0] = cv2.GC_FGD
    region = seeds.copy()
    has_both = (labels == cv2.GC_BGD).any() and np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).any()
    if not has_both:
        return region
    # GrabCut initialises its clusters at random.
    cv2.setRNGSeed(0)
    image = np.ascontiguousarray(edited[part][..., ::-1])
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(image, labels, _NO_RECTANGLE, *models, _ITERATIONS, cv2.GC_INIT_WITH_MASK)
    cut = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    # If object and street have the same colours, GrabCut may lose the object.
    if 2 * cut.sum() >= seeds[part].sum():
        region[part] = cut
    return region
