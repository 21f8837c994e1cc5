"""Converts images to network inputs, and network outputs to depth maps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.mvs.estimator import DepthMap, StereoImage
from hybridworldsim.mvs.learned.source_features import SourceFeatures
from hybridworldsim.mvs.learned.warping import (
    SampleMotion,
    compute_baseline_m,
    compute_motion,
    project_to_source,
    sample,
)
from mirror.devices import CPU

_MIN_BASELINE = 1e-6


@dataclass(frozen=True, eq=False)
class SourceImage:
    """A source image as a network input.

    Attributes:
        rgb: (3, h, w) from 0 to 1.
        motions: motion from the reference's features to the source's features, by feature stride.
        hidden: (h / stride, w / stride) by feature stride, 1 where a feature is no evidence, else 0; empty if all
            features are evidence.
    """

    rgb: Tensor
    motions: Mapping[int, SampleMotion]
    hidden: Mapping[int, Tensor]

    def with_features(self, stride: int, feature: Tensor) -> SourceFeatures:
        """Combine features (C, h / stride, w / stride) with their motion and their mask of hidden pixels."""
        return SourceFeatures(feature, self.motions[stride], self.hidden.get(stride))


def make_source_image(
    reference: StereoImage, source: StereoImage, strides: Sequence[int], device: str = CPU
) -> SourceImage:
    """Prepare a source image.

    Args:
        reference: the image of which depth is estimated.
        source: the source.
        strides: feature strides of the network; the sides are padded to multiples of the largest.
        device: where the network is.
    """
    rgb = to_network_input(source, max(strides)).to(device)
    rows, columns = rgb.shape[1:]
    hidden = {stride: downsample_hidden(source, stride, rows // stride, columns // stride) for stride in strides}
    return SourceImage(
        rgb,
        {stride: compute_motion(reference, source, stride) for stride in strides},
        {stride: mask.to(device) for stride, mask in hidden.items() if mask is not None},
    )


def to_network_input(image: StereoImage, stride: int) -> Tensor:
    """Convert to RGB (3, H, W) from 0 to 1, padded to multiples of the stride with the last row and column."""
    rgb = torch.from_numpy(np.ascontiguousarray(image.rgb)).permute(2, 0, 1).float().div_(255.0)
    height, width = image.rgb.shape[:2]
    bottom, right = -height % stride, -width % stride
    return functional.pad(rgb[None], (0, right, 0, bottom), "replicate")[0] if bottom or right else rgb


def downsample_hidden(image: StereoImage, stride: int, rows: int, columns: int) -> Tensor | None:
    """Mark samples (rows, columns) that contain an invalid pixel: 1 if so, else 0; None if all pixels are valid."""
    if image.valid.all():
        return None
    hidden = torch.from_numpy(~image.valid).float()
    height, width = hidden.shape
    padded = functional.pad(hidden[None, None], (0, columns * stride - width, 0, rows * stride - height))
    return functional.max_pool2d(padded, stride)[0, 0]


def select_useful_sources(reference: StereoImage, sources: Sequence[StereoImage], near_m: float) -> list[StereoImage]:
    """Select the sources that can distinguish depths: taken from another position, and with a valid pixel."""
    min_baseline_m = _MIN_BASELINE * near_m
    return [
        source for source in sources if source.valid.any() and compute_baseline_m(reference, source) > min_baseline_m
    ]


def drop_unseen_depth(
    reference: StereoImage, sources: Sequence[StereoImage], depth_m: Tensor, confidence: Tensor
) -> DepthMap:
    """Make a depth map; masked pixels, and pixels that no source sees at their depth, become unknown.

    Args:
        reference: the image.
        sources: the sources that were used.
        depth_m: (H, W) or larger, if the image was padded.
        confidence: of the same shape.
    """
    height, width = reference.valid.shape
    depth_m, confidence = depth_m[:height, :width].cpu(), confidence[:height, :width].cpu()
    visible = torch.zeros((height, width), dtype=torch.bool)
    for source in sources:
        rows, columns = source.valid.shape
        positions = project_to_source(compute_motion(reference, source, 1), depth_m[None], columns, rows)
        visible |= sample(torch.from_numpy(source.valid).float()[None], positions)[0, 0] > 0.5
    known = torch.from_numpy(reference.valid) & visible & torch.isfinite(depth_m) & (depth_m > 0.0)
    return DepthMap(
        torch.where(known, depth_m, torch.nan).numpy(), torch.where(known, confidence, 0.0).clamp_(0.0, 1.0).numpy()
    )


@contextmanager
def torch_inference(threads: int) -> Iterator[None]:
    """Switch gradients off and fix torch's number of threads, on which torch's sums depend."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(before)
