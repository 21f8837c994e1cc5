"""A floor without colour: each view shows the image of ``nearest_frame`` with its luma in all three channels.

A score that this floor raises rewards something other than the scene: luma in all channels is one of the recolourings
that raised PSNR after a colour fit (docs/threat-model/figures.md).
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

METHOD: Final = SubmittedMethod(
    name="grey_frame",
    version="1",
    licence="Apache-2.0",
    trained_on="nothing: images of the split's training traversals are copied without their colours",
)
APPEARANCE: Final = Appearance(
    policy="nearest-traversal", description="of the traversal that the nearest image is from, without colours"
)


def render(dataset: Dataset, plan: Plan) -> Iterator[Render]:
    """Render each view, grouped by shared image; see `mirror.evaluation.submission.writing.Renderer`."""
    for views, image in nearest_frame.render(dataset, plan):
        yield views, luma_image(image)


def luma_image(image: UInt8) -> UInt8:
    """Return an image (H, W, 3) with the luma of ITU-R BT.601, rounded, in all channels.

    Args:
        image: (H, W, 3), RGB.
    """
    luma = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.cvtColor(luma, cv2.COLOR_GRAY2RGB), np.uint8)
