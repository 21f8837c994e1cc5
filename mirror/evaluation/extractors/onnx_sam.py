"""Segment Anything (Kirillov et al., ICCV 2023) as ONNX, prompted by the region in which two renders differ."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from mirror.arrays import Bool, Float32, UInt8
from mirror.errors import UsageError
from mirror.evaluation.extractors.diff_grabcut import DiffGrabCut
from mirror.schema.files import sha256_bytes
from mirror.weights.resolve import file_sha256

_SIDE: Final = 1024
_MEAN: Final = np.array([123.675, 116.28, 103.53], np.float32)
_DEVIATION: Final = np.array([58.395, 57.12, 57.375], np.float32)
_BOX_LABELS: Final = (2.0, 3.0)


class OnnxSam:
    """An extractor that runs two networks: an encoder of the image, and a decoder of a prompt.

    ``encoder.onnx`` maps normalised pixels (1, 3, 1024, 1024) to image embeddings; ``decoder.onnx`` is the file that
    the model's own export script writes. The prompt is the bounding rectangle of the region in which the renders differ
    (`DiffGrabCut`), never the target box.

    Args:
        folder: folder of both files.

    Raises:
        UsageError: a file is missing, or onnxruntime is not installed.
    """

    def __init__(self, folder: str) -> None:
        files = [Path(folder) / name for name in ("encoder.onnx", "decoder.onnx")]
        self._encoder, self._decoder = map(_open_session, files)
        self._fingerprint = " ".join(map(file_sha256, files))
        self.identity = f"onnx-sam {sha256_bytes(self._fingerprint.encode())[:12]}"
        self._difference_extractor = DiffGrabCut()

    def extract(self, edited: UInt8, background: UInt8, counted: Bool, name: str) -> Bool:
        """See `Extractor`."""
        differing = self._difference_extractor.extract(edited, background, counted, name)
        if not differing.any():
            return differing
        height, width = counted.shape
        scale = _SIDE / max(height, width)
        embeddings = self._encoder.run(None, {self._encoder.get_inputs()[0].name: _prepare_input(edited, scale)})[0]
        rows, columns = np.flatnonzero(differing.any(axis=1)), np.flatnonzero(differing.any(axis=0))
        rectangle = [[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]]
        inputs = {
            "image_embeddings": embeddings,
            "point_coords": (np.array([rectangle], np.float32) * scale).astype(np.float32),
            "point_labels": np.array([_BOX_LABELS], np.float32),
            "mask_input": np.zeros((1, 1, 256, 256), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            "orig_im_size": np.array([height, width], np.float32),
        }
        masks, scores = self._decoder.run(None, inputs)[:2]
        return np.asarray((masks[0, int(np.argmax(scores[0]))] > 0.0) & counted)

    def fingerprint(self, name: str) -> str:
        """See `Extractor`: of both networks."""
        return self._fingerprint


def _prepare_input(image: UInt8, scale: float) -> Float32:
    height, width = (round(side * scale) for side in image.shape[:2])
    resized = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    padded = np.zeros((_SIDE, _SIDE, 3), np.float32)
    padded[:height, :width] = (resized.astype(np.float32) - _MEAN) / _DEVIATION
    return np.ascontiguousarray(padded.transpose(2, 0, 1)[None])


def _open_session(path: Path) -> Any:
    if not path.is_file():
        raise UsageError("missing", file=path, place="--extractor", expected="encoder.onnx and decoder.onnx")
    try:
        onnxruntime: Any = import_module("onnxruntime")
    except ImportError as error:
        raise UsageError(
            "onnxruntime is not installed", place="--extractor", remedy="pip install onnxruntime"
        ) from error
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
