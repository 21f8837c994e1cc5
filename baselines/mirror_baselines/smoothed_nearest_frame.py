"""A floor without detail: each view shows the image of ``nearest_frame`` with luma and colours smoothed.

A score that this floor raises above ``nearest_frame`` rewards a render that says less: `psnr_invariant` did so by up to
0.4 dB (docs/threat-model/figures.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.evaluation.submission.manifest import Appearance, SubmittedMethod
from mirror.evaluation.submission.writing import Render
from mirror.protocols.views import Plan
from mirror_baselines import nearest_frame

LUMA_SIGMA_PX: Final = 6.0
"""Standard deviation of the gaussian that smooths luma."""

CHROMA_SIGMA_PX: Final = 30.0
"""Standard deviation of the gaussian that smooths the differences of colours from luma."""

METHOD: Final = SubmittedMethod(
    name="smoothed_nearest_frame",
    version="1",
    licence="Apache-2.0",
    trained_on="nothing: images of the split's training traversals are copied and smoothed",
)
APPEARANCE: Final = Appearance(
    policy="nearest-traversal", description="of the traversal that the nearest image is from, smoothed"
)


def render(dataset: Dataset, plan: Plan) -> Iterator[Render]:
    """Render each view, grouped by shared image; see `mirror.evaluation.submission.writing.Renderer`."""
    for views, image in nearest_frame.render(dataset, plan):
        yield views, smooth_image(image, LUMA_SIGMA_PX, CHROMA_SIGMA_PX)


def smooth_image(image: UInt8, luma_sigma_px: float, chroma_sigma_px: float) -> UInt8:
    """Smooth an image by Gaussians: its luma (ITU-R BT.601), and the differences of its channels from luma.

    Args:
        image: (H, W, 3), RGB.
        luma_sigma_px: standard deviation for luma.
        chroma_sigma_px: standard deviation for the differences.
    """
    values = image.astype(np.float32)
    luma = values @ np.array([0.299, 0.587, 0.114], np.float32)
    smooth_luma = cv2.GaussianBlur(luma, (0, 0), luma_sigma_px, borderType=cv2.BORDER_REFLECT)
    chroma = values - luma[..., None]
    smooth_chroma = cv2.GaussianBlur(chroma, (0, 0), chroma_sigma_px, borderType=cv2.BORDER_REFLECT)
    return np.clip(np.rint(smooth_luma[..., None] + smooth_chroma), 0, 255).astype(np.uint8)
