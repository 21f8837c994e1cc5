"""SIFT features of images as pycolmap finds them, and their matches; how far off the truth they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.synth_matching.shots import Shot
from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera

_MODELS: Final = {
    "pinhole": ("PINHOLE", 0),
    "brown_conrady": ("FULL_OPENCV", 3),
    "rational": ("FULL_OPENCV", 0),
    "kannala_brandt": ("OPENCV_FISHEYE", 0),
}
_FARTHEST_RAD: Final = 0.7
_RATIO: Final = 0.8
_GREY: Final = np.array([0.114, 0.587, 0.299])


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one image.

    Attributes:
        uv_px: (N, 2).
        scale_px: (N,) their size: the larger, the less exact their place.
        descriptors: (N, 128) of unit length.
    """

    uv_px: Float64
    scale_px: Float64
    descriptors: Float32


def colmap() -> Any:
    """The module pycolmap, quiet.

    Its wheel exports the symbols of a zlib of its own: where Python's zlib is imported later, that is bound to parts of
    both, and crashes.
    """
    import zlib  # noqa: F401

    import pycolmap

    pycolmap.logging.minloglevel = 2
    return pycolmap


def colmap_camera(camera: Camera, camera_id: int = 1) -> Any:
    """A camera as pycolmap has it.

    Raises:
        UsageError: COLMAP has no such model.
    """
    if camera.model not in _MODELS:
        raise UsageError(f"camera model {camera.model}", expected=f"one that COLMAP has: {', '.join(_MODELS)}")
    name, zeros = _MODELS[camera.model]
    params = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion, *[0.0] * zeros]
    return colmap().Camera(
        camera_id=camera_id, model=name, width=camera.width_px, height=camera.height_px, params=params
    )


def features(shot: Shot, most: int = 4000) -> Features:
    """SIFT features of what stands still.

    Args:
        shot: the image.
        most: how many at most; the larger ones are kept.
    """
    pycolmap = colmap()
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1)
    options.sift.max_num_features = most
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    grey: UInt8 = np.round(shot.bgr @ _GREY).astype(np.uint8)
    keypoints, descriptors = extractor.extract_from_uint8_array(grey)
    table = np.asarray(pycolmap.keypoints_to_matrix(keypoints), np.float64)
    still = shot.still[shot.pixels(table[:, :2])]
    data = descriptors.data[still].astype(np.float32)
    return Features(table[still, :2], table[still, 2], data / np.linalg.norm(data, axis=1, keepdims=True))


def matches(one: Features, other: Features) -> Int64:
    """Pairs (M, 2) of features that are each other's nearest, and by far: COLMAP's rule with COLMAP's thresholds."""
    if len(one.uv_px) < 2 or len(other.uv_px) < 2:
        return np.zeros((0, 2), np.int64)
    alike = one.descriptors @ other.descriptors.T
    forth, back = _clear_nearest(alike), _clear_nearest(alike.T)
    first = np.flatnonzero(forth >= 0)
    first = first[back[forth[first]] == first]
    return np.stack([first, forth[first]], axis=1)


def verified(
    pairs: Int64, one: Features, first: Camera, other: Features, second: Camera, within_px: float = 2.0
) -> Int64:
    """The pairs that fit one relative pose of calibrated cameras, as pycolmap estimates it."""
    pycolmap = colmap()
    options = pycolmap.TwoViewGeometryOptions(detect_watermark=False)
    options.ransac.max_error, options.ransac.random_seed = within_px, 1
    geometry = pycolmap.estimate_calibrated_two_view_geometry(
        colmap_camera(first), one.uv_px, colmap_camera(second), other.uv_px, pairs.astype(np.uint32), options
    )
    return np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2)


def errors_px(pairs: Int64, one: Features, first: Shot, other: Features, second: Shot) -> Float64:
    """How far (M,) matches are off: from where the second image shows the first's point to the matched feature.

    Infinite where the second image cannot show that.
    """
    there = second.image_of(first.points(one.uv_px[pairs[:, 0]]))
    return np.nan_to_num(np.linalg.norm(there - other.uv_px[pairs[:, 1]], axis=1), nan=np.inf)


def _clear_nearest(alike: Float32) -> Int64:
    """The nearest (N,) by similarity (N, K); -1 where it is far, or the second nearest nearly as near."""
    rows = np.arange(len(alike))
    nearest = alike.argmax(axis=1)
    best = alike[rows, nearest]
    alike[rows, nearest] = -1.0
    second = alike.max(axis=1)
    alike[rows, nearest] = best
    angle, next_angle = np.arccos(np.minimum(best, 1.0)), np.arccos(np.minimum(second, 1.0))
    return np.where((angle <= _FARTHEST_RAD) & (angle < _RATIO * next_angle), nearest, -1)
