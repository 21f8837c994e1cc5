"""Sheets of images with captions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from mirror.arrays import UInt8

_CAPTION_PX: Final = 16
_GAP_PX: Final = 4


def sheet(rows: Sequence[Sequence[tuple[str, UInt8]]]) -> UInt8:
    """Join rows of captions and images (H, W, 3); short rows end in white."""
    strips = [np.hstack([_captioned(*tile) for tile in row]) for row in rows]
    width = max(strip.shape[1] for strip in strips)
    whole = [np.pad(one, ((0, _GAP_PX), (0, width - one.shape[1]), (0, 0)), constant_values=255) for one in strips]
    return np.vstack(whole)


def _captioned(text: str, image: UInt8) -> UInt8:
    """An image (H, W, 3) under a line of text, with a gap to its right."""
    tile = np.pad(image, ((_CAPTION_PX, 0), (0, _GAP_PX), (0, 0)), constant_values=255)
    cv2.putText(tile, text, (2, _CAPTION_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return tile
