"""SIFT features of images and their matches.

OpenCV's first pixel has its centre at (0, 0); half a pixel is added once, here. Its SIFT enlarges the image by a factor
of two first; without ``enable_precise_upscale`` all features would be a quarter of a pixel too far right and down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.calibration.descriptors import COLMAP_FARTHEST_RAD, find_clear_nearest
from mirror.calibration.tracking import OPENCV_OFFSET_PX, TrackedImage

_CONTRAST: Final = 0.02
_OCTAVE_LAYERS: Final = 3


@dataclass(frozen=True, eq=False)
class ImageFeatures:
    """Features of one image.

    Attributes:
        uv_px: (N, 2) positions; the centre of the first pixel is at (0.5, 0.5).
        scale_px: (N,) standard deviation of the Gaussian in which each was found; larger ones have a larger error.
        descriptors: (N, 128) histograms of gradients.
    """

    uv_px: Float64
    scale_px: Float64
    descriptors: UInt8

    def __len__(self) -> int:
        return len(self.uv_px)

    def unit_descriptors(self) -> Float32:
        """Return unit vectors (N, 128), the roots of the normalised histograms (R. Arandjelovic, A. Zisserman 2012)."""
        histograms = self.descriptors.astype(np.float32)
        return np.sqrt(histograms / np.maximum(histograms.sum(axis=1, keepdims=True), 1.0))


def find_features(image: TrackedImage, most: int) -> ImageFeatures:
    """Find features of static surfaces.

    Args:
        image: the image.
        most: largest number; the features with the most contrast are kept.
    """
    import cv2

    sift = cv2.SIFT.create(
        nfeatures=most, nOctaveLayers=_OCTAVE_LAYERS, contrastThreshold=_CONTRAST, enable_precise_upscale=True
    )
    found, raw = sift.detectAndCompute(image.grey, image.is_static.astype(np.uint8))
    if raw is None:
        return ImageFeatures(np.empty((0, 2)), np.empty(0), np.empty((0, 128), np.uint8))
    uv = np.array([point.pt for point in found], np.float64) + OPENCV_OFFSET_PX
    scale = 0.5 * np.array([point.size for point in found], np.float64)
    # A place with two orientations is one feature of the track builder: the first is kept.
    _, first = np.unique(np.round(uv, 2), axis=0, return_index=True)
    first = np.sort(first)
    return ImageFeatures(uv[first], scale[first], raw[first].astype(np.uint8))


def match_features(one: ImageFeatures, other: ImageFeatures) -> Int64:
    """Return the pairs (M, 2) of mutually nearest features that are clearly nearer than the second nearest."""
    if len(one) < 2 or len(other) < 2:
        return np.zeros((0, 2), np.int64)
    first_units, second_units = one.unit_descriptors(), other.unit_descriptors()
    alike = first_units @ second_units.T
    forth = find_clear_nearest(first_units, second_units, alike, farthest_rad=COLMAP_FARTHEST_RAD)
    alike = np.ascontiguousarray(alike.T)
    back = find_clear_nearest(second_units, first_units, alike, farthest_rad=COLMAP_FARTHEST_RAD)
    first = np.flatnonzero(forth >= 0)
    first = first[back[forth[first]] == first]
    return np.stack([first, forth[first]], axis=1)
