"""Detectors of the YOLO family as ONNX models: outputs of versions 5 and 8, and of models that suppress duplicates."""

from __future__ import annotations

from functools import partial
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.privacy.detectors.boxes import suppress, to_regions
from mirror.privacy.detectors.protocol import DetectorKind, DetectorOptions
from mirror.privacy.detectors.sessions import DetectorError, hash_weights, open_session
from mirror.privacy.regions import Kind, Region

_THRESHOLD: Final = 0.2
_OVERLAP: Final = 0.6
_GREY: Final = 114
_STRIDE: Final = 32


class YoloDetector:
    """A detector of the YOLO family from the user's file of weights; all its classes count as one kind.

    Args:
        options: weights and threshold.
        kind: what it finds.
    """

    version = "1"

    def __init__(self, options: DetectorOptions, kind: Kind) -> None:
        self.kind: Kind = kind
        self.name = f"yolo_{kind}s"
        path, self.weights_sha256 = hash_weights(self.name, options.weights)
        self.threshold = _THRESHOLD if options.threshold is None else options.threshold
        self._session = open_session(path.read_bytes(), path)
        self._path = path
        self._input = self._session.get_inputs()[0]
        if len(self._input.shape) != 4 or self._input.type != "tensor(float)":
            raise DetectorError(
                f"its input is {self._input.type} of shape {self._input.shape}", file=path,
                expected="tensor(float) of shape 1 x 3 x H x W",
            )  # fmt: skip

    def __call__(self, image: UInt8) -> list[Region]:
        """Find regions in an image (H, W, 3), RGB."""
        height, width = image.shape[:2]
        fixed_h, fixed_w = self._input.shape[2:]
        target_h = fixed_h if isinstance(fixed_h, int) else -(-height // _STRIDE) * _STRIDE
        target_w = fixed_w if isinstance(fixed_w, int) else -(-width // _STRIDE) * _STRIDE
        scale = min(target_h / height, target_w / width)
        # A model of a dynamic size gets the image at its own scale.
        scale = scale if isinstance(fixed_h, int) or isinstance(fixed_w, int) else 1.0
        size = (max(round(width * scale), 1), max(round(height * scale), 1))
        board = np.full((target_h, target_w, 3), _GREY, np.uint8)
        board[: size[1], : size[0]] = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
        blob = (board.transpose(2, 0, 1)[None] / 255.0).astype(np.float32)
        output = self._session.run(None, {self._input.name: blob})[0]
        boxes, scores = decode_yolo(np.asarray(output, np.float64), self.threshold)
        return to_regions(boxes / scale, scores, self.kind, self.name, (width, height))


def decode_yolo(output: Float64, threshold: float) -> tuple[Float64, Float64]:
    """Decode the output of a network to boxes (N, 4) and scores (N,).

    Args:
        output: (1, N, 6): corners, score and class, duplicates removed; (1, N, 5 + C) with N above C: centre, size,
            score and classes (version 5); or (1, 4 + C, N): centre, size and classes (version 8). With one class the
            last two have 6 and 5 values a box.
        threshold: smallest score.

    Raises:
        DetectorError: the shape is another.
    """
    if output.ndim != 3 or output.shape[0] != 1 or min(output.shape[1:]) < 5:
        raise DetectorError(f"an output of shape {output.shape}", expected="1 x N x 6, 1 x N x (5+C) or 1 x (4+C) x N")
    rows = output[0]
    if rows.shape[0] < rows.shape[1]:
        centres, scores = rows[:4].T, rows[4:].max(axis=0)
    elif rows.shape[1] == 6 and _has_corners(rows):
        kept = rows[:, 4] > threshold
        return rows[kept, :4], rows[kept, 4]
    else:
        centres = rows[:, :4]
        scores = rows[:, 4] * (rows[:, 5:].max(axis=1) if rows.shape[1] > 5 else 1.0)
    kept = scores > threshold
    centres, scores = centres[kept], scores[kept]
    boxes = np.concatenate([centres[:, :2] - 0.5 * centres[:, 2:], centres[:, :2] + 0.5 * centres[:, 2:]], axis=1)
    rest = suppress(boxes, scores, _OVERLAP)
    return boxes[rest], scores[rest]


def _has_corners(rows: Float64) -> bool:
    """Return whether rows are left, top, right, bottom, score, class: a whole class, right and bottom larger."""
    return bool((rows[:, 5] == np.rint(rows[:, 5])).all() and (rows[:, 2:4] >= rows[:, :2]).all())


FACES: Final = DetectorKind(
    "face", "an ONNX model of the YOLO family, by path", partial(YoloDetector, kind="face"), needs_weights=True
)
PLATES: Final = DetectorKind(
    "plate", "an ONNX model of the YOLO family, by path; state the regions of its plates: NAME=FILE@EU,US",
    partial(YoloDetector, kind="plate"), needs_weights=True,
)  # fmt: skip
