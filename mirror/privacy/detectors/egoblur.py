"""EgoBlur (N. Raina et al., 2023) as TorchScript, by path: the first generation, and scripts with the same outputs.

The scripts call operators of torchvision, which does not load beside every torch: where they are not registered, the
two that the models need are defined here in plain torch.
"""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import UInt8
from mirror.installation import install_command
from mirror.privacy.detectors.boxes import suppress, to_regions
from mirror.privacy.detectors.protocol import DetectorKind, DetectorOptions
from mirror.privacy.detectors.sessions import DetectorError, hash_weights
from mirror.privacy.regions import Kind, Region

if TYPE_CHECKING:
    from torch import Tensor

_THRESHOLD: Final = 0.5
_OVERLAP: Final = 0.3


class EgoBlur:
    """A detector in TorchScript: takes one image (3, H, W), BGR, uint8; returns boxes, labels, scores and more.

    Args:
        options: weights and threshold; its authors use 0.9.
        kind: what the script finds: there is one for faces and one for plates.
    """

    version = "1"

    def __init__(self, options: DetectorOptions, kind: Kind) -> None:
        self.kind: Kind = kind
        self.name = f"egoblur_{kind}s"
        path, self.weights_sha256 = hash_weights(self.name, options.weights)
        self.threshold = _THRESHOLD if options.threshold is None else options.threshold
        try:
            import torch
        except ImportError as error:
            raise DetectorError("torch is not installed", file=path, remedy=install_command("models")) from error
        register_operators()
        try:
            self._script: Any = torch.jit.load(str(path), map_location="cpu").eval()
        except RuntimeError as error:
            problem = f"the script cannot be read: {error}".splitlines()[0]
            raise DetectorError(problem, file=path, expected="a TorchScript of EgoBlur") from error

    def __call__(self, image: UInt8) -> list[Region]:
        """Find regions in an image (H, W, 3), RGB."""
        import torch

        planes = torch.from_numpy(np.ascontiguousarray(image[..., ::-1].transpose(2, 0, 1)))
        with torch.inference_mode():
            outputs = self._script(planes)
        boxes, scores = (outputs[index].detach().numpy().astype(np.float64) for index in (0, 2))
        kept = scores > self.threshold
        boxes, scores = boxes.reshape(-1, 4)[kept], scores[kept]
        rest = suppress(boxes, scores, _OVERLAP)
        return to_regions(boxes[rest], scores[rest], self.kind, self.name, (image.shape[1], image.shape[0]))


@cache
def register_operators() -> None:
    """Define the operators ``torchvision::nms`` and ``torchvision::roi_align`` unless torchvision defines them."""
    import torch

    own = torch.library.Library("torchvision", "FRAGMENT")
    signatures = {
        "nms": ("(Tensor dets, Tensor scores, float iou_threshold) -> Tensor", _nms),
        "roi_align": (
            "(Tensor input, Tensor rois, float spatial_scale, int pooled_height, int pooled_width, int sampling_ratio,"
            " bool aligned) -> Tensor",
            roi_align,
        ),
    }
    for name, (signature, function) in signatures.items():
        try:
            own.define(f"{name}{signature}")
        except RuntimeError:
            # torchvision is loaded, and defines it.
            continue
        own.impl(name, function, "CPU")
    _libraries.append(own)


_libraries: Final[list[Any]] = []
"""An operator exists as long as its library."""


def _nms(dets: Tensor, scores: Tensor, iou_threshold: float) -> Tensor:
    import torch

    kept = suppress(dets.double().numpy(), scores.double().numpy(), iou_threshold)
    return torch.from_numpy(kept)


def roi_align(
    features: Tensor,
    rois: Tensor,
    spatial_scale: float,
    pooled_height: int,
    pooled_width: int,
    sampling_ratio: int,
    aligned: bool,
) -> Tensor:
    """Pool features in regions by bilinear samples (K. He et al., "Mask R-CNN", 2017), as torchvision defines it.

    Args:
        features: (N, C, H, W).
        rois: (K, 5): number of the image, left, top, right, bottom.
        spatial_scale: pixels of the features for one unit of ``rois``.
        pooled_height: rows of the result.
        pooled_width: columns of the result.
        sampling_ratio: samples a bin and axis; 0 or less: as many as pixels lie in the bin, rounded up.
        aligned: whether pixel centres lie at half numbers.

    Returns:
        (K, C, pooled_height, pooled_width).
    """
    import torch

    count, (height, width) = len(rois), features.shape[2:]
    result = features.new_zeros((count, features.shape[1], pooled_height, pooled_width))
    for number in range(count):
        image, box = int(rois[number, 0]), rois[number, 1:] * spatial_scale - (0.5 if aligned else 0.0)
        span_w, span_h = float(box[2] - box[0]), float(box[3] - box[1])
        if not aligned:
            span_w, span_h = max(span_w, 1.0), max(span_h, 1.0)
        along = [
            _bin_samples(float(start), span, bins, sampling_ratio)
            for start, span, bins in ((box[1], span_h, pooled_height), (box[0], span_w, pooled_width))
        ]
        v, u = (torch.as_tensor(values, dtype=features.dtype) for values in along)
        rows, columns = _weights(v, height, features), _weights(u, width, features)
        sampled = rows @ features[image] @ columns.T
        shape = (features.shape[1], pooled_height, len(v) // pooled_height, pooled_width, len(u) // pooled_width)
        result[number] = sampled.reshape(shape).mean(dim=(2, 4))
    return result


def _bin_samples(start: float, span: float, bins: int, ratio: int) -> list[float]:
    """Coordinates of the samples of all bins along an axis."""
    samples = ratio if ratio > 0 else max(int(np.ceil(span / bins)), 1)
    step = span / bins
    return [start + step * (number + (sample + 0.5) / samples) for number in range(bins) for sample in range(samples)]


def _weights(places: Tensor, size: int, like: Tensor) -> Tensor:
    """Weights (P, size) of linear interpolation; places more than a pixel outside of the raster have none."""
    import torch

    inside = (places >= -1.0) & (places <= size)
    places = places.clamp(0.0, size - 1.0)
    low = places.floor().long()
    high = (low + 1).clamp(max=size - 1)
    share = places - low
    weights = like.new_zeros((len(places), size))
    index = torch.arange(len(places))
    weights[index, low] += 1.0 - share
    weights[index, high] += share
    return weights * inside[:, None]


FACES: Final = DetectorKind(
    "face", "EgoBlur for faces, TorchScript by path", partial(EgoBlur, kind="face"), needs_weights=True
)
PLATES: Final = DetectorKind(
    "plate", "EgoBlur for plates, TorchScript by path; state the regions of its plates: NAME=FILE@EU,US",
    partial(EgoBlur, kind="plate"), needs_weights=True,
)  # fmt: skip
