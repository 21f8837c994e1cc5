"""Nearest neighbours among descriptors of image features, the same on every processor.

The similarity of many descriptors is a product of matrices in float32. Its last digits depend on the processor,
because BLAS has a kernel for each family. Near similarity 1 they decide: the angle between equal descriptors comes out
as 0 on one processor and as 6e-4 radians on another. The two most similar descriptors are therefore compared again, by
their chord in float64.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64, Int64

COLMAP_RATIO: Final = 0.8
"""Largest ratio of the angles to the nearest and to the second nearest descriptor (COLMAP's)."""
COLMAP_FARTHEST_RAD: Final = 0.7
"""Largest angle between the descriptors of a match (COLMAP's)."""


def find_clear_nearest(
    first: Float32, second: Float32, similarity: Float32, ratio: float = COLMAP_RATIO, farthest_rad: float = np.inf
) -> Int64:
    """Find, for each descriptor of the first image, the nearest of the second, if it is clearly the nearest.

    Args:
        first: (N, D) unit vectors.
        second: (K, D) unit vectors, K >= 2.
        similarity: (N, K) their dot products.
        ratio: the angle to the nearest is below this part of the angle to the second nearest (D. Lowe 2004).
        farthest_rad: largest angle to the nearest.

    Returns:
        (N,) indices into ``second``; -1 where the nearest is too far or not clear, as between equal descriptors.
    """
    nearest, angle, next_angle = _compare_candidates(first, second, similarity)
    return np.where((angle <= farthest_rad) & (angle < ratio * next_angle), nearest, -1)


def find_nearest(first: Float32, second: Float32, similarity: Float32) -> Int64:
    """Find, for each descriptor of the first image, the nearest (N,) of the second; on a tie the earlier."""
    return _compare_candidates(first, second, similarity)[0]


def measure_angles(first: Float32, second: Float32) -> Float64:
    """Measure the angles (N,) in radians between unit vectors (N, D) by their chords, accurate near zero too."""
    chord = np.linalg.norm(first.astype(np.float64) - second, axis=1)
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))


def _compare_candidates(first: Float32, second: Float32, similarity: Float32) -> tuple[Int64, Float64, Float64]:
    """Compare the two most similar descriptors: the nearest (N,), its angle and the angle of the other, radians."""
    rows = np.arange(len(first))
    one = similarity.argmax(axis=1)
    best = similarity[rows, one]
    similarity[rows, one] = -np.inf
    other = similarity.argmax(axis=1)
    similarity[rows, one] = best
    angle, other_angle = measure_angles(first, second[one]), measure_angles(first, second[other])
    swapped = (other_angle < angle) | ((other_angle == angle) & (other < one))
    nearest = np.where(swapped, other, one)
    return nearest, np.minimum(angle, other_angle), np.maximum(angle, other_angle)
