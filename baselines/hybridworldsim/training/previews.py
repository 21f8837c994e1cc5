"""Previews of a run: renders of a few views beside truth and depth, at every report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch

from hybridworldsim.trainable.method import TrainableMethod
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Source
from mirror.arrays import UInt8
from mirror.schema.files import write_bytes

_NEAR_M: Final = 1.0
_FAR_M: Final = 200.0
_QUALITY: Final = 90


@dataclass(frozen=True, eq=False)
class Preview:
    """An image that is rendered repeatedly during training.

    Attributes:
        name: prefix of its files.
        image: the recorded image.
        source: traversal and camera of the appearance.
    """

    name: str
    image: TrainingImage
    source: Source


def write_previews(folder: Path, previews: Sequence[Preview], trainer: TrainableMethod, step: int) -> None:
    """Render all previews to ``<name>-<step>.jpg``: render | truth | depth.

    Raises:
        DatasetError: the folder is not writable.
    """
    for preview in previews:
        rendered = trainer.render(preview.image.viewpoint.with_source(preview.source))
        parts = (pixels(rendered.rgb), pixels(preview.image.rgb), _depth_colours(rendered.depth_m))
        sheet = np.concatenate(parts, axis=1)[..., ::-1]
        data = cv2.imencode(".jpg", np.ascontiguousarray(sheet), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
        write_bytes(folder / f"{preview.name}-{step:06d}.jpg", data)


def pixels(rgb: torch.Tensor) -> UInt8:
    """Convert colours (H, W, 3) from float to 8 bits."""
    shown = rgb.detach().clamp(0.0, 1.0).mul(255.0).round().to(torch.uint8)
    return np.asarray(shown.cpu().numpy(), np.uint8)


def _depth_colours(depth_m: torch.Tensor) -> UInt8:
    metres = np.nan_to_num(depth_m.detach().cpu().numpy(), nan=_FAR_M, posinf=_FAR_M).clip(_NEAR_M, _FAR_M)
    share = 1.0 - np.log(metres / _NEAR_M) / np.log(_FAR_M / _NEAR_M)
    coloured = cv2.applyColorMap((255.0 * share).astype(np.uint8), cv2.COLORMAP_INFERNO)
    return np.asarray(coloured[..., ::-1], np.uint8)
