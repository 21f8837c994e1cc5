"""Sparse points: SIFT features, matched where the known poses allow it, and triangulated by pycolmap."""

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
from mirror.errors import UsageError
from mirror.installation import install_command

_MOST_FEATURES: Final = 2000
_RATIO: Final = 0.8
_EPIPOLAR_PX: Final = 2.0
_LUMA: Final = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features of one picture.

    Attributes:
        uv_px: (N, 2).
        descriptors: (N, 128), of any length: bytes, so that those of thousands of pictures are held.
    """

    uv_px: Float64
    descriptors: UInt8


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """Triangulated points.

    Attributes:
        cloud: the points; deviations are not known.
        first: (N,) the earliest picture that sees each.
    """

    cloud: PointCloud
    first: Int64


def triangulate(picture_of: Callable[[int], StereoImage], sources: Sequence[Int64]) -> SparsePoints:
    """The points that pictures of known poses have in common.

    Args:
        picture_of: gives the picture at a position; each is asked for once.
        sources: for each picture the positions of those it is matched with.

    Raises:
        UsageError: pycolmap is not installed.
    """
    features: dict[int, Features] = {}
    cameras: dict[int, tuple[Float64, Float64]] = {}
    colours: dict[int, Any] = {}
    sizes: dict[int, tuple[int, int]] = {}
    for number in range(len(sources)):
        picture = picture_of(number)
        features[number] = extract_features(picture)
        place = np.clip(features[number].uv_px.astype(np.int64), 0, np.array(picture.valid.shape[::-1]) - 1)
        colours[number] = picture.rgb[place[:, 1], place[:, 0]]
        cameras[number] = picture.K, picture.world_SE3_camera.inverse().matrix()[0]
        sizes[number] = picture.valid.shape
    pairs = {(min(a, b), max(a, b)) for a, own in enumerate(sources) for b in own.tolist()}
    matches = {}
    for one, other in sorted(pairs):
        found = _match_features(features[one], features[other], _fundamental(cameras[one], cameras[other]))
        if len(found):
            matches[one, other] = found
    if not matches:
        return SparsePoints(PointCloud.concatenate([]), np.empty(0, np.int64))
    return _triangulate_matches(features, colours, cameras, sizes, matches)


def extract_features(picture: StereoImage) -> Features:
    """SIFT features of what stands still, the largest first.

    Raises:
        UsageError: pycolmap is not installed.
    """
    pycolmap = _import_pycolmap()
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1)
    options.sift.max_num_features = _MOST_FEATURES
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract_from_uint8_array(np.round(picture.rgb @ _LUMA).astype(np.uint8))
    if not len(keypoints):
        return Features(np.empty((0, 2)), np.empty((0, 128), np.uint8))
    table = np.asarray(pycolmap.keypoints_to_matrix(keypoints), np.float64).reshape(len(keypoints), -1)
    uv = table[:, :2].reshape(-1, 2)
    place = np.clip(uv.astype(np.int64), 0, np.array(picture.valid.shape[::-1]) - 1)
    still = picture.valid[place[:, 1], place[:, 0]]
    return Features(uv[still], np.asarray(descriptors.data, np.uint8)[still].reshape(-1, 128))


def _match_features(one: Features, other: Features, fundamental: Float64) -> Int64:
    """Pairs (M, 2) of features that are each other's nearest, by far, on each other's epipolar lines."""
    if min(len(one.uv_px), len(other.uv_px)) < 2:
        return np.empty((0, 2), np.int64)
    alike = _unit(one.descriptors) @ _unit(other.descriptors).T
    forth, back = _clear_nearest(alike), alike.argmax(axis=0)
    first = np.flatnonzero(forth >= 0)
    pairs = np.stack([first, forth[first]], axis=1)[back[forth[first]] == first]
    a = np.column_stack([one.uv_px[pairs[:, 0]], np.ones(len(pairs))])
    b = np.column_stack([other.uv_px[pairs[:, 1]], np.ones(len(pairs))])
    line_b, line_a = a @ fundamental.T, b @ fundamental
    product = (b * line_b).sum(axis=1) ** 2
    # Sampson's distance (Hartley and Zisserman, Multiple View Geometry, section 11.4.3).
    gradient = (line_b[:, :2] ** 2).sum(axis=1) + (line_a[:, :2] ** 2).sum(axis=1)
    return np.asarray(pairs[product < _EPIPOLAR_PX**2 * np.maximum(gradient, 1e-30)])


def _unit(descriptors: UInt8) -> Float32:
    data = descriptors.astype(np.float32)
    return data / np.maximum(np.linalg.norm(data, axis=1, keepdims=True), np.float32(1e-12))


def _clear_nearest(alike: Float32) -> Int64:
    """The most alike (N,) of (N, K), -1 where the second is nearly as much."""
    two = np.argpartition(alike, -2, axis=1)[:, -2:]
    score = np.take_along_axis(alike, two, axis=1)
    order = np.argsort(score, axis=1)
    best = np.take_along_axis(two, order[:, 1:], axis=1)[:, 0]
    angle = np.arccos(np.clip(np.take_along_axis(score, order, axis=1), -1.0, 1.0))
    return np.where(angle[:, 1] < _RATIO * angle[:, 0], best, -1)


def _fundamental(one: tuple[Float64, Float64], other: tuple[Float64, Float64]) -> Float64:
    """F with b^T F a = 0 for a point's pixels a in one and b in the other picture."""
    motion = other[1] @ np.linalg.inv(one[1])
    x, y, z = motion[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.linalg.inv(other[0]).T @ cross @ motion[:3, :3] @ np.linalg.inv(one[0]))


def _triangulate_matches(
    features: Mapping[int, Features],
    colours: Mapping[int, Any],
    cameras: Mapping[int, tuple[Float64, Float64]],
    sizes: Mapping[int, tuple[int, int]],
    matches: Mapping[tuple[int, int], Int64],
) -> SparsePoints:
    pycolmap = _import_pycolmap()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "matches.db"
        there = _make_reconstruction(features, cameras, sizes)
        with pycolmap.Database.open(path) as database:
            for number, camera in there.cameras.items():
                database.write_camera(camera, use_camera_id=True)
                database.write_rig(there.rigs[number], use_rig_id=True)
            for number, own in features.items():
                database.write_frame(there.frames[number + 1], use_frame_id=True)
                database.write_image(there.images[number + 1], use_image_id=True)
                database.write_keypoints(number + 1, own.uv_px.astype(np.float32))
            kind = int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED)
            for (one, other), pairs in matches.items():
                geometry = pycolmap.TwoViewGeometry(config=kind, inlier_matches=pairs.astype(np.uint32))
                database.write_two_view_geometry(one + 1, other + 1, geometry)
        options = pycolmap.IncrementalPipelineOptions(extract_colors=False, random_seed=1)
        options.triangulation.random_seed = 1
        found = pycolmap.triangulate_points(there, path, folder, folder, options=options)
    position, rgb, views, first = [], [], [], []
    for number in sorted(found.points3D):
        point = found.points3D[number]
        seen = [(element.image_id - 1, element.point2D_idx) for element in point.track.elements]
        position.append(point.xyz)
        rgb.append(np.mean([colours[picture][feature] for picture, feature in seen], axis=0))
        views.append(len({picture for picture, _ in seen}))
        first.append(min(seen)[0])
    count = len(position)
    cloud = PointCloud(
        np.reshape(position, (count, 3)).astype(np.float64),
        np.round(np.reshape(rgb, (count, 3))).astype(np.uint8),
        np.array(views, np.int32),
        np.full(count, np.nan, np.float32),
    )
    return SparsePoints(cloud, np.array(first, np.int64))


def _make_reconstruction(
    features: Mapping[int, Features],
    cameras: Mapping[int, tuple[Float64, Float64]],
    sizes: Mapping[int, tuple[int, int]],
) -> Any:
    """The pictures as pycolmap has them: each of a camera and a frame of its own."""
    pycolmap = _import_pycolmap()
    there = pycolmap.Reconstruction()
    for number, own in features.items():
        (height, width), (K, camera_from_world) = sizes[number], cameras[number]
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        there.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=number + 1, model="PINHOLE", width=width, height=height, params=params)
        )
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(camera_from_world[:3, :3]), camera_from_world[:3, 3])
        image = pycolmap.Image(f"{number:06}", own.uv_px, camera_id=number + 1, image_id=number + 1)
        there.add_image_with_trivial_frame(image, pose)
    return there


def _import_pycolmap() -> Any:
    """The module pycolmap, quiet.

    Its wheel exports the symbols of a zlib of its own: Python's is imported before it, or would be bound to parts of
    both, and crash.
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
