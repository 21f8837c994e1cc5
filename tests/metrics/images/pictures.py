"""Pictures that the tests of image metrics share."""

from __future__ import annotations

import numpy as np


def street(height=90, width=160, seed=0):
    """A smooth picture with texture, and a render of it in other colours with noise; uint8 RGB."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    wave = 120 + 80 * np.sin(x / 17.0) * np.cos(y / 13.0)
    truth = wave[..., None] * (1.0, 0.9, 0.75) + rng.normal(0, 8, (height, width, 3))
    render = 255 * (np.clip(truth, 0, 255) / 255) ** 0.85 * (0.95, 0.9, 1.0) + rng.normal(0, 6, truth.shape)
    return tuple(np.clip(np.rint(picture), 0, 255).astype(np.uint8) for picture in (render, truth))


def ellipse(height, width, rows, columns):
    """A mask that fills a rectangle's ellipse."""
    mask = np.zeros((height, width), bool)
    y, x = np.mgrid[-1 : 1 : 1j * (rows.stop - rows.start), -1 : 1 : 1j * (columns.stop - columns.start)]
    mask[rows, columns] = y * y + x * x <= 1
    return mask
