"""The detector of number plates of many countries: a small network that was trained on synthetic plates.

Its weights are a part of the package. ``weights/README.md`` says how they were made, and ``weights/world_plates.json``
which share of the plates of each region it finds on synthetic images.
"""

from __future__ import annotations

import hashlib
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from mirror.arrays import Bool, Float64, UInt8
from mirror.privacy.detectors.boxes import suppress, to_regions
from mirror.privacy.detectors.protocol import DetectorKind, DetectorOptions
from mirror.privacy.detectors.recall import SyntheticRecall, covered_regions
from mirror.privacy.detectors.sessions import open_session
from mirror.privacy.regions import Kind, Region
from mirror.schema.files import read_json
from mirror.weights.errors import WeightsUnavailableError

SHIPPED: Final = Path(str(files("mirror.privacy.detectors") / "weights" / "world_plates.onnx"))
SHA256: Final = "c33b8950f42387b87a5fb60963dad47bee843aa4696edd9e85dde416e16abdaa"
RECALL: Final = SHIPPED.with_suffix(".json")
_THRESHOLD: Final = 0.2
_STRIDE: Final = 64
_SMALLER: Final = 0.4
_NEAR_PX: Final = 96.0
"""Width from which boxes of the smaller image count: they are there for plates near the camera."""
_OVERLAP: Final = 0.5
_GREY: Final = 114


class WorldPlates:
    """Plate detector ``world_plates.onnx``, without anchors, at the image's scale and at 0.4 of it.

    Args:
        options: weights and threshold.
    """

    kind: Kind = "plate"
    name = "world_plates"
    version = "1"

    def __init__(self, options: DetectorOptions) -> None:
        path = SHIPPED if options.weights is None else options.weights
        try:
            data = path.read_bytes()
        except OSError as error:
            raise _unavailable(path, "cannot be read") from error
        self.weights_sha256 = hashlib.sha256(data).hexdigest()
        if self.weights_sha256 != SHA256:
            raise _unavailable(path, f"sha256 {self.weights_sha256}; the published file has {SHA256}")
        self.threshold = _THRESHOLD if options.threshold is None else options.threshold
        self._session: Any = open_session(data, path)

    def __call__(self, image: UInt8) -> list[Region]:
        """Find number plates in an image (H, W, 3), RGB."""
        height, width = image.shape[:2]
        boxes, scores = self._find(image)
        size = (max(round(_SMALLER * width), 1), max(round(_SMALLER * height), 1))
        near, near_scores = self._find(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8))
        near = near * np.tile(np.array([width, height]) / size, 2)
        wide: Bool = near[:, 2] - near[:, 0] >= _NEAR_PX
        boxes, scores = np.concatenate([boxes, near[wide]]), np.concatenate([scores, near_scores[wide]])
        kept = suppress(boxes, scores, _OVERLAP)
        return to_regions(boxes[kept], scores[kept], self.kind, self.name, (width, height))

    def _find(self, image: UInt8) -> tuple[Float64, Float64]:
        """Boxes (N, 4) and scores (N,) above the threshold; the image is padded to whole cells."""
        height, width = image.shape[:2]
        board = np.full((-(-height // _STRIDE) * _STRIDE, -(-width // _STRIDE) * _STRIDE, 3), _GREY, np.uint8)
        board[:height, :width] = image
        rows = self._session.run(None, {"images": board.transpose(2, 0, 1)[None].astype(np.float32)})[0][0]
        found = rows[rows[:, 4] > self.threshold].astype(np.float64)
        return found[:, :4], found[:, 4]


def _unavailable(path: Path, problem: str) -> WeightsUnavailableError:
    return WeightsUnavailableError(
        problem, file=path, place="detector world_plates", expected="the file that is a part of the package",
        remedy="install the package again, or name the published file: --detector world_plates=FILE",
    )  # fmt: skip


def read_recall() -> SyntheticRecall:
    """Return the published recall on synthetic plates."""
    return read_json(RECALL, SyntheticRecall)


WORLD_PLATES: Final = DetectorKind(
    "plate", "number plates of many countries, 4.7 MB, a part of this package", WorldPlates,
    covered_regions(read_recall(), SHA256),
)  # fmt: skip
