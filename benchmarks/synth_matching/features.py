"""SIFT features of images from pycolmap, their matches, and the errors of the matches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.synth_matching.posed_images import PosedImage
from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.calibration.descriptors import COLMAP_FARTHEST_RAD, find_clear_nearest
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera

_MODELS: Final = {
    "pinhole": ("PINHOLE", 0),
    "brown_conrady": ("FULL_OPENCV", 3),
    "rational": ("FULL_OPENCV", 0),
    "kannala_brandt": ("OPENCV_FISHEYE", 0),
}
_GREY: Final = np.array([0.114, 0.587, 0.299])


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features of one image.

    Attributes:
        uv_px: (N, 2) positions.
        scale_px: (N,) sizes; larger features have less exact positions.
        descriptors: (N, 128) descriptors of unit length.
    """

    uv_px: Float64
    scale_px: Float64
    descriptors: Float32


def colmap() -> Any:
    """Import pycolmap without its log output.

    The pycolmap wheel exports symbols of its own zlib. If Python's zlib is imported after it, Python's zlib binds to
    symbols of both and crashes, so zlib is imported first.
    """
    import zlib  # noqa: F401

    import pycolmap

    pycolmap.logging.minloglevel = 2
    return pycolmap


def colmap_camera(camera: Camera, camera_id: int = 1) -> Any:
    """Convert a camera to pycolmap's.

    Raises:
        UsageError: COLMAP does not have the camera model.
    """
    if camera.model not in _MODELS:
        raise UsageError(f"camera model {camera.model}", expected=f"a model of COLMAP: {', '.join(_MODELS)}")
    name, zeros = _MODELS[camera.model]
    params = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion, *[0.0] * zeros]
    return colmap().Camera(
        camera_id=camera_id, model=name, width=camera.width_px, height=camera.height_px, params=params
    )


def extract_features(image: PosedImage, most: int = 4000) -> Features:
    """Extract SIFT features of static surfaces.

    Args:
        image: the image.
        most: largest number of features; the larger features are kept.
    """
    pycolmap = colmap()
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1)
    options.sift.max_num_features = most
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    grey: UInt8 = np.round(image.bgr @ _GREY).astype(np.uint8)
    keypoints, descriptors = extractor.extract_from_uint8_array(grey)
    table = np.asarray(pycolmap.keypoints_to_matrix(keypoints), np.float64)
    is_static = image.is_static[image.pixels(table[:, :2])]
    data = descriptors.data[is_static].astype(np.float32)
    return Features(table[is_static, :2], table[is_static, 2], data / np.linalg.norm(data, axis=1, keepdims=True))


def match_features(one: Features, other: Features) -> Int64:
    """Return pairs (M, 2) of mutual nearest neighbours that pass the ratio test, by COLMAP's rule and thresholds."""
    if len(one.uv_px) < 2 or len(other.uv_px) < 2:
        return np.zeros((0, 2), np.int64)
    alike = one.descriptors @ other.descriptors.T
    forth = find_clear_nearest(one.descriptors, other.descriptors, alike, farthest_rad=COLMAP_FARTHEST_RAD)
    alike = np.ascontiguousarray(alike.T)
    back = find_clear_nearest(other.descriptors, one.descriptors, alike, farthest_rad=COLMAP_FARTHEST_RAD)
    first = np.flatnonzero(forth >= 0)
    first = first[back[forth[first]] == first]
    return np.stack([first, forth[first]], axis=1)


def verify_matches(
    pairs: Int64, one: Features, first: Camera, other: Features, second: Camera, within_px: float = 2.0
) -> Int64:
    """Return the pairs that fit one relative pose of calibrated cameras, as estimated by pycolmap."""
    pycolmap = colmap()
    options = pycolmap.TwoViewGeometryOptions(detect_watermark=False)
    options.ransac.max_error, options.ransac.random_seed = within_px, 1
    geometry = pycolmap.estimate_calibrated_two_view_geometry(
        colmap_camera(first), one.uv_px, colmap_camera(second), other.uv_px, pairs.astype(np.uint32), options
    )
    return np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2)


def match_errors_px(pairs: Int64, one: Features, first: PosedImage, other: Features, second: PosedImage) -> Float64:
    """Return the errors (M,) of matches.

    An error is the distance of the matched feature from the first feature's true position.

    The error is infinite where the second image does not show the point.
    """
    projected = second.image_of(first.points(one.uv_px[pairs[:, 0]]))
    return np.nan_to_num(np.linalg.norm(projected - other.uv_px[pairs[:, 1]], axis=1), nan=np.inf)
