"""Sparse points: SIFT features, matched along epipolar lines of the known poses, and triangulated by pycolmap."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from hybridworldsim.mvs.estimator import StereoImage
from hybridworldsim.mvs.fusion import PointCloud
from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.calibration.descriptors import find_clear_nearest, find_nearest
from mirror.errors import UsageError
from mirror.installation import install_command

_MAX_FEATURES: Final = 2000
_EPIPOLAR_PX: Final = 2.0
_LUMA: Final = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features of one image.

    Attributes:
        uv_px: (N, 2).
        descriptors: (N, 128), not normalised; bytes, so that the descriptors of thousands of images fit into memory.
    """

    uv_px: Float64
    descriptors: UInt8


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """Points triangulated from matched features.

    Attributes:
        cloud: the points; their standard deviations are unknown.
        first_image: (N,) index of the first image that shows each point.
    """

    cloud: PointCloud
    first_image: Int64


def triangulate(get_image: Callable[[int], StereoImage], sources: Sequence[Int64]) -> SparsePoints:
    """Triangulate the common points of images with known poses.

    Args:
        get_image: returns the image of an index; it is called once for each image.
        sources: for each image the indices of the images that it is matched with.

    Raises:
        UsageError: pycolmap is not installed.
    """
    features: dict[int, Features] = {}
    cameras: dict[int, tuple[Float64, Float64]] = {}
    colours: dict[int, Any] = {}
    sizes: dict[int, tuple[int, int]] = {}
    for number in range(len(sources)):
        image = get_image(number)
        features[number] = extract_features(image)
        pixel = np.clip(features[number].uv_px.astype(np.int64), 0, np.array(image.valid.shape[::-1]) - 1)
        colours[number] = image.rgb[pixel[:, 1], pixel[:, 0]]
        cameras[number] = image.K, image.world_SE3_camera.inverse().matrix()[0]
        sizes[number] = image.valid.shape
    pairs = {(min(a, b), max(a, b)) for a, others in enumerate(sources) for b in others.tolist()}
    matches = {}
    for first, second in sorted(pairs):
        fundamental = _compute_fundamental(cameras[first], cameras[second])
        matched = match_features(features[first], features[second], fundamental)
        if len(matched):
            matches[first, second] = matched
    if not matches:
        return SparsePoints(PointCloud.concatenate([]), np.empty(0, np.int64))
    return _triangulate_matches(features, colours, cameras, sizes, matches)


def extract_features(image: StereoImage) -> Features:
    """Extract the SIFT features of valid pixels, the largest first.

    Raises:
        UsageError: pycolmap is not installed.
    """
    pycolmap = _import_pycolmap()
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1)
    options.sift.max_num_features = _MAX_FEATURES
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract_from_uint8_array(np.round(image.rgb @ _LUMA).astype(np.uint8))
    if not len(keypoints):
        return Features(np.empty((0, 2)), np.empty((0, 128), np.uint8))
    table = np.asarray(pycolmap.keypoints_to_matrix(keypoints), np.float64).reshape(len(keypoints), -1)
    uv = table[:, :2].reshape(-1, 2)
    pixel = np.clip(uv.astype(np.int64), 0, np.array(image.valid.shape[::-1]) - 1)
    static = image.valid[pixel[:, 1], pixel[:, 0]]
    return Features(uv[static], np.asarray(descriptors.data, np.uint8)[static].reshape(-1, 128))


def match_features(first: Features, second: Features, fundamental: Float64) -> Int64:
    """Match features (M, 2): mutual nearest neighbours that pass the ratio test and lie on their epipolar lines."""
    if min(len(first.uv_px), len(second.uv_px)) < 2:
        return np.empty((0, 2), np.int64)
    first_units, second_units = _normalise(first.descriptors), _normalise(second.descriptors)
    similarity = first_units @ second_units.T
    forth = find_clear_nearest(first_units, second_units, similarity)
    back = find_nearest(second_units, first_units, np.ascontiguousarray(similarity.T))
    row = np.flatnonzero(forth >= 0)
    pairs = np.stack([row, forth[row]], axis=1)[back[forth[row]] == row]
    a = np.column_stack([first.uv_px[pairs[:, 0]], np.ones(len(pairs))])
    b = np.column_stack([second.uv_px[pairs[:, 1]], np.ones(len(pairs))])
    line_b, line_a = a @ fundamental.T, b @ fundamental
    product = (b * line_b).sum(axis=1) ** 2
    # Sampson's distance (Hartley and Zisserman, Multiple View Geometry, section 11.4.3).
    gradient = (line_b[:, :2] ** 2).sum(axis=1) + (line_a[:, :2] ** 2).sum(axis=1)
    return np.asarray(pairs[product < _EPIPOLAR_PX**2 * np.maximum(gradient, 1e-30)])


def _normalise(descriptors: UInt8) -> Float32:
    """Scale descriptors to unit length."""
    data = descriptors.astype(np.float32)
    return data / np.maximum(np.linalg.norm(data, axis=1, keepdims=True), np.float32(1e-12))


def _compute_fundamental(first: tuple[Float64, Float64], second: tuple[Float64, Float64]) -> Float64:
    """Compute the fundamental matrix F: b^T F a = 0 for a point at pixel a in the first and b in the second image."""
    motion = second[1] @ np.linalg.inv(first[1])
    x, y, z = motion[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.linalg.inv(second[0]).T @ cross @ motion[:3, :3] @ np.linalg.inv(first[0]))


def _triangulate_matches(
    features: Mapping[int, Features],
    colours: Mapping[int, Any],
    cameras: Mapping[int, tuple[Float64, Float64]],
    sizes: Mapping[int, tuple[int, int]],
    matches: Mapping[tuple[int, int], Int64],
) -> SparsePoints:
    """Triangulate matches with pycolmap, and convert its points."""
    pycolmap = _import_pycolmap()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "matches.db"
        reconstruction = _make_reconstruction(features, cameras, sizes)
        with pycolmap.Database.open(path) as database:
            for number, camera in reconstruction.cameras.items():
                database.write_camera(camera, use_camera_id=True)
                database.write_rig(reconstruction.rigs[number], use_rig_id=True)
            for number, of_image in features.items():
                database.write_frame(reconstruction.frames[number + 1], use_frame_id=True)
                database.write_image(reconstruction.images[number + 1], use_image_id=True)
                database.write_keypoints(number + 1, of_image.uv_px.astype(np.float32))
            kind = int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED)
            for (first, second), pairs in matches.items():
                geometry = pycolmap.TwoViewGeometry(config=kind, inlier_matches=pairs.astype(np.uint32))
                database.write_two_view_geometry(first + 1, second + 1, geometry)
        options = pycolmap.IncrementalPipelineOptions(extract_colors=False, random_seed=1)
        options.triangulation.random_seed = 1
        triangulated = pycolmap.triangulate_points(reconstruction, path, folder, folder, options=options)
    position, rgb, views, first_image = [], [], [], []
    for number in sorted(triangulated.points3D):
        point = triangulated.points3D[number]
        observations = [(element.image_id - 1, element.point2D_idx) for element in point.track.elements]
        position.append(point.xyz)
        rgb.append(np.mean([colours[image][feature] for image, feature in observations], axis=0))
        views.append(len({image for image, _ in observations}))
        first_image.append(min(observations)[0])
    count = len(position)
    cloud = PointCloud(
        np.reshape(position, (count, 3)).astype(np.float64),
        np.round(np.reshape(rgb, (count, 3))).astype(np.uint8),
        np.array(views, np.int32),
        np.full(count, np.nan, np.float32),
    )
    return SparsePoints(cloud, np.array(first_image, np.int64))


def _make_reconstruction(
    features: Mapping[int, Features],
    cameras: Mapping[int, tuple[Float64, Float64]],
    sizes: Mapping[int, tuple[int, int]],
) -> Any:
    """Make a pycolmap reconstruction of the posed images; each image has its own camera and frame."""
    pycolmap = _import_pycolmap()
    reconstruction = pycolmap.Reconstruction()
    for number, of_image in features.items():
        (height, width), (K, camera_from_world) = sizes[number], cameras[number]
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        reconstruction.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=number + 1, model="PINHOLE", width=width, height=height, params=params)
        )
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(camera_from_world[:3, :3]), camera_from_world[:3, 3])
        image = pycolmap.Image(f"{number:06}", of_image.uv_px, camera_id=number + 1, image_id=number + 1)
        reconstruction.add_image_with_trivial_frame(image, pose)
    return reconstruction


def _import_pycolmap() -> Any:
    """Import pycolmap and silence its log.

    The wheel of pycolmap exports the symbols of its own zlib. Python's zlib is imported first; otherwise Python would
    bind to symbols of both and crash.
    """
    import zlib  # noqa: F401

    try:
        import pycolmap
    except ModuleNotFoundError as error:
        raise UsageError(
            "pycolmap is not installed", remedy=f"{install_command('calibration')}, or another method"
        ) from error
    pycolmap.logging.minloglevel = 2
    return pycolmap
