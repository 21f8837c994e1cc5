"""A ``Parser`` for gsplat's example trainer that opens a dataset without an export.

It has the attributes that ``Dataset`` and ``Runner`` of gsplat's examples read. Images are the dataset's own files,
which are read when they are needed. Distorted lenses of every model are undistorted by maps, as ``Dataset`` does it.

Source: https://github.com/nerfstudio-project/gsplat/blob/main/examples/datasets/colmap.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mirror.arrays import Bool, Float32, Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.dataset import open as open_dataset
from mirror.errors import UsageError
from mirror.export.scene import ExportImage, select_scene
from mirror.geometry.cameras import Camera


class Parser:
    """A scene of a dataset as gsplat's examples read it.

    Args:
        data_dir: folder of the dataset; ``FOLDER#SCENE`` names one of several scenes.
        factor: only 1: images are the dataset's own files.
        normalize: move the centre of the cameras to the origin and scale their largest distance to 1.
        test_every: every n-th image is for tests, in the order of names; not used if `split` is given.
        split: split whose held-out traversals are for tests.

    Raises:
        UsageError: the factor is not 1, the scene is not named, or images are frames of videos or lie in a bucket.
    """

    def __init__(
        self, data_dir: str, factor: int = 1, normalize: bool = False, test_every: int = 8, *, split: str | None = None
    ) -> None:
        if factor != 1:
            raise UsageError(f"factor {factor}", expected="1: images are the dataset's own files", remedy="export it")
        root, _, scene = data_dir.partition("#")
        dataset = open_dataset(root)
        selected = select_scene(dataset, scene or None, split, undistort=True)
        images = sorted(selected.images, key=lambda item: item.name)
        self.data_dir, self.factor, self.normalize, self.test_every = root, factor, normalize, test_every
        self.image_names = [item.name for item in images]
        self.image_paths = [local_path(dataset, item) for item in images]
        self.roles = [item.role for item in images]
        poses = np.concatenate([item.world_SE3_camera.matrix() for item in images])
        poses[:, :3, 3] -= selected.origin_m
        points = selected.points
        xyz = np.zeros((0, 3)) if points is None else points.position_m - selected.origin_m
        self.transform = _normalisation(poses) if normalize else np.eye(4)
        scale = float(np.cbrt(np.linalg.det(self.transform[:3, :3])))
        self.camtoworlds: Float64 = self.transform @ poses
        self.camtoworlds[:, :3, :3] /= scale
        self.points: Float32 = (xyz @ self.transform[:3, :3].T + self.transform[:3, 3]).astype(np.float32)
        self.points_rgb = np.zeros((0, 3), np.uint8) if points is None else points.rgb
        self.points_err = np.zeros(len(xyz), np.float32)
        self.point_indices: dict[str, Float32] = {}
        self._add_cameras(images)
        centre = self.camtoworlds[:, :3, 3].mean(axis=0)
        self.scene_scale = float(np.linalg.norm(self.camtoworlds[:, :3, 3] - centre, axis=1).max())
        self.bounds = np.array([0.01, 1.0])
        self.extconf = {"spiral_radius_scale": 1.0, "no_factor_suffix": False}

    def _add_cameras(self, images: list[ExportImage]) -> None:
        """Number the lenses, and make the maps that undistort their images."""
        ids: dict[Camera, int] = {}
        self.camera_ids = [ids.setdefault(item.raster.recorded, len(ids) + 1) for item in images]
        self.camera_id_to_idx = {number: number - 1 for number in ids.values()}
        self.camera_indices = [number - 1 for number in self.camera_ids]
        self.num_cameras = len(ids)
        self.Ks_dict: dict[int, Float64] = {}
        self.params_dict: dict[int, Float32] = {}
        self.imsize_dict: dict[int, tuple[int, int]] = {}
        self.mask_dict: dict[int, Bool | None] = {}
        self.mapx_dict: dict[int, Float32] = {}
        self.mapy_dict: dict[int, Float32] = {}
        self.roi_undist_dict: dict[int, list[int]] = {}
        for item in images:
            number, lens = ids[item.raster.recorded], item.lens
            if number in self.Ks_dict:
                continue
            self.Ks_dict[number] = lens.intrinsic_matrix()
            self.imsize_dict[number] = (lens.width_px, lens.height_px)
            self.mask_dict[number] = None if item.raster.maps is None else item.raster.covered
            # The trainer undistorts the images of cameras with coefficients, whichever they are.
            self.params_dict[number] = np.array(item.raster.recorded.distortion, np.float32)
            if item.raster.maps is not None:
                self.mapx_dict[number], self.mapy_dict[number] = item.raster.maps
                self.roi_undist_dict[number] = [0, 0, lens.width_px, lens.height_px]


def local_path(dataset: Dataset, item: ExportImage) -> str:
    """Return the path of an image's file on this machine.

    Raises:
        UsageError: the image is a frame of a video, a part of a file, or elsewhere.
    """
    image = item.image
    if dataset.store.folder is None or "://" in image.uri or image.video_pts is not None or image.byte_offset:
        raise UsageError(
            "the image is not a file of this machine", file=image.uri, place=f"camera {image.camera}",
            expected="JPEG or PNG files in the dataset's folder", remedy="export it: mirror export gsplat DATASET",
        )  # fmt: skip
    return str(dataset.store.read_stable(image.uri, Path.absolute))


def _normalisation(poses: Float64) -> Float64:
    """The similarity (4, 4) that moves the cameras' centre to the origin, with the largest distance 1."""
    centre = poses[:, :3, 3].mean(axis=0)
    scale = 1.0 / max(float(np.linalg.norm(poses[:, :3, 3] - centre, axis=1).max()), 1e-9)
    similarity = np.eye(4)
    similarity[:3, :3] *= scale
    similarity[:3, 3] = -scale * centre
    return similarity
