"""Maps of used images by pycolmap's incremental mapper, from features and matches of ours.

A known lens of any model becomes an ideal camera of the same focal length: its features are unprojected first. An
unknown lens is one focal length and one radial coefficient (COLMAP's ``SIMPLE_RADIAL``), estimated with the map.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.calibration.refinement.features import ImageFeatures, match_features
from mirror.errors import UsageError
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera

_WIDEST_DEG: Final = 72.0
"""Features farther from the axis of a known lens are not used: an ideal camera magnifies them without bound."""
_LEAST_MATCHES: Final = 20
_FOCAL_GUESS: Final = 0.9
"""Focal length of an unknown lens at the start, as a share of the width: 58 degrees."""
_FARTHER: Final = (16, 24, 32)
"""Further images that an image is matched with, by number: they bridge gaps."""


@dataclass(frozen=True, eq=False)
class MappedImages:
    """The images of a map with their features.

    Attributes:
        features: N sets of features.
        camera: (N,) number of the camera of each image.
        lenses: lens of each camera; None: it is estimated.
        sizes_px: width and height of the images of each camera.
    """

    features: Sequence[ImageFeatures]
    camera: Int64
    lenses: Sequence[Camera | None]
    sizes_px: Sequence[tuple[int, int]]

    def __len__(self) -> int:
        return len(self.features)


@dataclass(frozen=True, eq=False)
class ImageMap:
    """One map: registered images and points, in a frame and scale of its own.

    Attributes:
        used: (F,) numbers of the registered images, ascending.
        world_SE3_camera: F poses.
        points: (P, 3) points.
        observed: for each registered image the points (K,) and the features (K,) that show them.
        lenses: the lens of each camera, estimated if it was unknown; None: the map has no image of it.
        residual_px: mean distance of the features from the projections of their points.
        reconstruction: pycolmap's own, to be adjusted further.
    """

    used: Int64
    world_SE3_camera: Poses
    points: Float64
    observed: list[tuple[Int64, Int64]]
    lenses: Sequence[Camera | None]
    residual_px: float
    reconstruction: Any

    @property
    def lens(self) -> Camera:
        """The lens of the only camera of the map."""
        (lens,) = self.lenses
        if lens is None:
            raise UsageError("the map has no image", expected="registered images")
        return lens


def map_images(
    images: MappedImages, partners: Sequence[Sequence[int]], advance: Callable[[int], None]
) -> tuple[list[ImageMap], int]:
    """Match images and map them.

    Args:
        images: the images.
        partners: for each image the later ones that it is matched with.
        advance: is called with 1 after each image that was matched.

    Returns:
        The maps, the one with the most images first, each image in one map only; and the number of matched pairs.
    """
    import pycolmap

    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(0)
    with tempfile.TemporaryDirectory(prefix="mirror-poses-") as folder:
        file = Path(folder) / "images.db"
        kept, matched = _write_database(file, images, partners, advance)
        options = pycolmap.IncrementalPipelineOptions()
        options.random_seed = 0
        options.extract_colors = False
        options.min_model_size = 3
        is_free = any(lens is None for lens in images.lenses)
        options.ba_refine_focal_length = options.ba_refine_extra_params = is_free
        # A vehicle drives along the axis of its front camera: the angles between rays are small.
        options.mapper.init_max_forward_motion = 1.0
        options.mapper.init_min_tri_angle = 4.0
        options.mapper.filter_min_tri_angle = options.triangulation.min_angle = 0.5
        found = pycolmap.incremental_mapping(file, folder, folder, options)
        maps, taken = [], set[int]()
        for reconstruction in sorted(found.values(), key=lambda one: -one.num_reg_images()):
            one = _read_map(reconstruction, images, kept, taken)
            if one is not None:
                maps.append(one)
                taken.update(one.used.tolist())
    return maps, matched


def sequence_partners(count: int, neighbours: int, near: Int64) -> list[list[int]]:
    """Return the later images that each image of a sequence is matched with.

    Args:
        count: number of images, in order of time.
        neighbours: number of following images.
        near: (N, 2) further pairs.
    """
    partners = []
    for one in range(count):
        own = set(range(one + 1, one + 1 + neighbours)) | {one + step for step in _FARTHER}
        own |= set(near[near[:, 0] == one, 1].tolist()) | set(near[near[:, 1] == one, 0].tolist())
        partners.append(sorted(other for other in own if one < other < count))
    return partners


def ideal_camera(lens: Camera) -> Camera:
    """Return the pinhole camera of a lens' focal length and raster, whose features `map_images` uses."""
    across, tall = lens.fx_px, lens.fy_px
    if lens.model == "f_theta":
        # The pixels a radian about the axis.
        rays = np.array([[np.tan(1e-3), 0.0, 1.0], [0.0, 0.0, 1.0]])
        across = tall = float(np.diff(lens.project(rays).uv_px[::-1, 0])[0] / 1e-3)
    return Camera("pinhole", lens.width_px, lens.height_px, across, tall, lens.cx_px, lens.cy_px)


def to_ideal(features: ImageFeatures, lens: Camera | None) -> tuple[Float64, Int64]:
    """Return the positions (K, 2) of features in the ideal camera, and the features (K,) that it has."""
    if lens is None:
        return features.uv_px, np.arange(len(features), dtype=np.int64)
    rays = lens.unproject(features.uv_px).direction
    kept = np.flatnonzero(np.isfinite(rays).all(axis=1) & (rays[:, 2] > np.cos(np.radians(_WIDEST_DEG))))
    return ideal_camera(lens).project(rays[kept]).uv_px, kept.astype(np.int64)


def _write_database(
    file: Path, images: MappedImages, partners: Sequence[Sequence[int]], advance: Callable[[int], None]
) -> tuple[list[Int64], int]:
    """Write features and verified matches; return the features of each image in the file, and the number of pairs."""
    import pycolmap

    database = pycolmap.Database.open(file)
    cameras, rigs = [], []
    for lens, size in zip(images.lenses, images.sizes_px):
        camera = to_pycolmap(lens, size)
        camera.camera_id = database.write_camera(camera)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(camera.sensor_id)
        cameras.append(camera)
        rigs.append(database.write_rig(rig))
    places, kept, ids = [], [], []
    for number, (features, own) in enumerate(zip(images.features, images.camera.tolist())):
        uv, shown = to_ideal(features, images.lenses[own])
        image = pycolmap.Image(name=f"{number:08d}", camera_id=cameras[own].camera_id)
        image.image_id = database.write_image(image)
        frame = pycolmap.Frame()
        frame.rig_id = rigs[own]
        frame.add_data_id(image.data_id)
        database.write_frame(frame)
        database.write_keypoints(image.image_id, uv.astype(np.float32))
        places.append(uv)
        kept.append(shown)
        ids.append(image.image_id)
    options, pairs = pycolmap.TwoViewGeometryOptions(), 0
    options.ransac.random_seed = 0
    parts = [_part(features, own) for features, own in zip(images.features, kept)]
    for one, others in enumerate(partners):
        for other in others:
            found = match_features(parts[one], parts[other]).astype(np.uint32)
            if len(found) < _LEAST_MATCHES:
                continue
            first, second = cameras[images.camera[one]], cameras[images.camera[other]]
            geometry = pycolmap.estimate_two_view_geometry(first, places[one], second, places[other], found, options)
            if len(geometry.inlier_matches) >= _LEAST_MATCHES:
                database.write_matches(ids[one], ids[other], found)
                database.write_two_view_geometry(ids[one], ids[other], geometry)
                pairs += 1
        advance(1)
    database.close()
    return kept, pairs


def _part(features: ImageFeatures, own: Int64) -> ImageFeatures:
    return ImageFeatures(features.uv_px[own], features.scale_px[own], features.descriptors[own])


def to_pycolmap(lens: Camera | None, size: tuple[int, int]) -> Any:
    """Return pycolmap's camera: the ideal one of a lens, or the first guess of an unknown one."""
    import pycolmap

    raster = {"width": size[0], "height": size[1]}
    if lens is None:
        params = [_FOCAL_GUESS * max(size), 0.5 * size[0], 0.5 * size[1], 0.0]
        return pycolmap.Camera(model="SIMPLE_RADIAL", params=params, **raster)
    ideal = ideal_camera(lens)
    params = [ideal.fx_px, ideal.fy_px, ideal.cx_px, ideal.cy_px]
    return pycolmap.Camera(model="PINHOLE", params=params, has_prior_focal_length=True, **raster)


def _read_map(reconstruction: Any, images: MappedImages, kept: list[Int64], taken: set[int]) -> ImageMap | None:
    """Return a map without the images that another map has; None: it has no others."""
    registered = {int(one.name): one for one in reconstruction.images.values() if one.has_pose}
    used = [number for number in sorted(registered) if number not in taken]
    if not used:
        return None
    ids = sorted(reconstruction.points3D)
    place = {number: row for row, number in enumerate(ids)}
    observed = []
    for number in used:
        shown = enumerate(registered[number].points2D)
        seen = [(place[two.point3D_id], row) for row, two in shown if two.has_point3D()]
        pairs = np.array(seen, np.int64).reshape(-1, 2)
        observed.append((pairs[:, 0], kept[number][pairs[:, 1]]))
    points = np.array([reconstruction.points3D[one].xyz for one in ids]).reshape(-1, 3)
    lenses: list[Camera | None] = list(images.lenses)
    for number in used:
        own = int(images.camera[number])
        if images.lenses[own] is None:
            lenses[own] = _estimated(registered[number].camera, images.sizes_px[own])
    poses, residual = read_poses(reconstruction, used), float(reconstruction.compute_mean_reprojection_error())
    return ImageMap(np.array(used, np.int64), poses, points, observed, lenses, residual, reconstruction)


def read_poses(reconstruction: Any, used: list[int]) -> Poses:
    """Return the poses ``world_SE3_camera`` of the images with these numbers."""
    by_number = {int(one.name): one for one in reconstruction.images.values()}
    back = [by_number[number].cam_from_world().inverse() for number in used]
    turns = np.array([one.rotation.matrix() for one in back])
    return Poses(quaternion_from_matrix(turns), np.array([one.translation for one in back]))


def _estimated(camera: Any, size: tuple[int, int]) -> Camera:
    focal, x, y, k1 = (float(value) for value in camera.params)
    return Camera("brown_conrady", *size, focal, focal, x, y, (k1, 0.0, 0.0, 0.0, 0.0))
