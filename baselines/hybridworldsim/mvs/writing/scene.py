"""The initialisation of one scene: depth of its images, confirmed depth, sky masks and points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import pyarrow as pa

from hybridworldsim.kept_items import KeptItems
from hybridworldsim.mvs.estimator import DepthEstimator
from hybridworldsim.mvs.fusion import ConfirmedDepth, PointCloud, PosedDepth, VoxelThinner, confirm, make_point_cloud
from hybridworldsim.mvs.ground import FittedGround, compute_wheel_contacts, fit_ground, read_driven_poses
from hybridworldsim.mvs.images.pairs import choose_sources
from hybridworldsim.mvs.images.posed_images import PosedImage, StereoImageCache, list_posed_images
from hybridworldsim.mvs.methods import MIN_CONFIDENCE
from hybridworldsim.mvs.options import InitialisationOptions
from hybridworldsim.mvs.sky import find_sky
from hybridworldsim.mvs.sparse import triangulate
from hybridworldsim.mvs.writing.layers import InitialisationLayers
from mirror.arrays import AnyArray, Bool, Float32, Float64
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.images.depth_codec import decode_depth, encode_depth
from mirror.devices import CPU
from mirror.errors import DatasetError
from mirror.methods.training_images import ImageKey
from mirror.progress import ProgressReporter
from mirror.schema.files import read_table, write_bytes
from mirror.schema.finished_work import hash_values
from mirror.schema.tables import DEPTH, MASKS, POINTS

_MAX_CACHED_MAPS: Final = 512
_GROUND_M: Final = 0.2
_MAX_BELOW_M: Final = 0.4


class PixelCounts(NamedTuple):
    """Numbers of pixels of the depth maps that were written.

    Attributes:
        known: pixels with a confirmed depth.
        static: pixels that show the static scene.
    """

    known: int
    static: int

    def plus(self, other: PixelCounts) -> PixelCounts:
        """Add counts."""
        return PixelCounts(self.known + other.known, self.static + other.static)


class SceneInitialisation:
    """The initialisation of one scene: computes and writes its layers.

    Args:
        view: the training traversals of the scene.
        layers: the layers to write.
        options: the options.
        withheld: images that are not opened.
        progress: receives the phases and their progress.
        device: where depth maps are compared and the sky is found, as torch names it.

    Attributes:
        counts: number of points written, by kind.
    """

    def __init__(
        self,
        view: Dataset,
        layers: InitialisationLayers,
        options: InitialisationOptions,
        withheld: Set[ImageKey],
        progress: ProgressReporter,
        device: str = CPU,
    ) -> None:
        self._layers, self._options, self._progress, self._device = layers, options, progress, device
        self._images = list_posed_images(view, options.pixels, withheld, options.standing_m)
        self._stereo_images = StereoImageCache(self._images, options.pixels)
        self._sources = choose_sources(self._images, max(options.sources, options.held_against))
        self._depth_cache: KeptItems[int, Float32] = KeptItems(_MAX_CACHED_MAPS)
        self._hashes = ContentHashes(view.store)
        rigs = view.table("traversals", ["rig_id"]).column(0).to_pylist()
        self._rigs = [self._hashes.rig(rig_id) for rig_id in rigs]
        self._raw_files: dict[int, Path] = {}
        self._image_hashes: dict[int, str | None] = {}
        self._driven = compute_wheel_contacts(read_driven_poses(view))
        self._driven_ground = fit_ground(self._driven)
        self.counts: dict[str, int] = {}

    def estimate(self, estimator: DepthEstimator) -> int:
        """Estimate the depth of all images without a depth file; return their number.

        Each depth map is a file in the work folder. The next run reuses the files of an interrupted one.
        """
        options = self._options
        todo = [number for number in range(len(self._images)) if not self._raw_file(number).is_file()]
        self._progress.start("depth", len(todo))
        for number in todo:
            sources = [self._stereo_images[other] for other in self._sources[number][: options.sources].tolist()]
            depth_map = estimator(self._stereo_images[number], sources, options.near_m, options.far_m)
            confident = depth_map.confidence >= self._min_confidence
            write_bytes(self._raw_file(number), encode_depth(np.where(confident, depth_map.depth_m, np.nan)))
            self._progress.advance(1)
        return len(todo)

    def confirm(self) -> tuple[dict[str, PointCloud], PixelCounts]:
        """Write confirmed depth maps and sky masks.

        Returns:
            The thinned points by traversal, and the pixel counts of the depth maps that were written.
        """
        self._progress.start("fusion", len(self._images))
        voxels = VoxelThinner(self._options.voxel_m)
        clouds: dict[str, PointCloud] = {}
        pixels = PixelCounts(0, 0)
        for traversal_id, numbers in self._group_by_traversal():
            if self._layers.has(traversal_id, "points"):
                clouds[traversal_id] = voxels.thin(self._read_points(traversal_id))
                self._progress.advance(len(numbers))
                continue
            clouds[traversal_id], added = self._confirm_traversal(traversal_id, numbers, voxels)
            pixels = pixels.plus(added)
        return clouds, pixels

    def _confirm_traversal(
        self, traversal_id: str, numbers: Sequence[int], voxels: VoxelThinner
    ) -> tuple[PointCloud, PixelCounts]:
        """Write the depth maps and sky masks of one traversal; return its thinned points and pixel counts."""
        depth, masks = self._layers.writer(traversal_id, "depth"), self._layers.writer(traversal_id, "masks")
        parts: list[PointCloud] = []
        depth_rows: list[dict[str, Any]] = []
        mask_rows: list[dict[str, Any]] = []
        known, static = 0, 0
        for number in numbers:
            posed, image = self._images[number], self._stereo_images[number]
            confirmed = self._confirm_image(number)
            agreed = confirmed.views >= self._options.depth_views
            depth_m = np.where(agreed, confirmed.depth_m, np.nan).astype(np.float32)
            known, static = known + int(agreed.sum()), static + int(image.valid.sum())
            cloud = make_point_cloud(confirmed, image.rgb, image.K, posed.world_SE3_camera, self._options.point_views)
            parts.append(voxels.thin(cloud))
            if depth is not None:
                depth_rows.append(
                    {**_make_key(posed), **_lens_columns(posed), **depth.file(_file_name(posed), encode_depth(depth_m))}
                )
            if masks is not None:
                mask = _distort_mask(find_sky(image, depth_m, self._device), posed)
                mask_rows.append(
                    {**_make_key(posed), "kind": "sky", **masks.file(_file_name(posed), _encode_png(mask))}
                )
            self._progress.advance(1)
        if depth is not None:
            depth.finish(DEPTH, depth_rows)
        if masks is not None:
            masks.finish(MASKS, mask_rows)
        return PointCloud.concatenate(parts), PixelCounts(known, static)

    def triangulate(self) -> dict[str, PointCloud]:
        """Triangulate sparse points; each belongs to the traversal of the first image that shows the point."""
        self._progress.start("sparse points", 1)
        sources = [candidates[: self._options.sources] for candidates in self._sources]
        points = triangulate(self._stereo_images.__getitem__, sources)
        owner = np.array([self._images[number].traversal_id for number in points.first_image.tolist()], dtype=object)
        self._progress.advance(1)
        return {
            traversal_id: points.cloud.select(owner == traversal_id) for traversal_id, _ in self._group_by_traversal()
        }

    def write_points(self, clouds: Mapping[str, PointCloud]) -> FittedGround:
        """Fit the ground, classify the points and write their layers; return the ground."""
        scene_cloud = PointCloud.concatenate(list(clouds.values()))
        ground = fit_ground(self._driven, scene_cloud.position_m)
        for traversal_id, cloud in clouds.items():
            kind = self._classify(cloud.position_m, ground)
            for name, count in zip(*np.unique(kind, return_counts=True)):
                self.counts[str(name)] = self.counts.get(str(name), 0) + int(count)
            writer = self._layers.writer(traversal_id, "points")
            if writer is not None:
                writer.finish(POINTS, _make_point_table(cloud, kind))
        return ground

    @property
    def _min_confidence(self) -> float:
        chosen = self._options.least_confidence
        return MIN_CONFIDENCE.get(self._layers.source, 0.0) if chosen is None else chosen

    def _group_by_traversal(self) -> Iterator[tuple[str, list[int]]]:
        """Yield each traversal with the indices of its images."""
        for traversal_id in sorted({posed.traversal_id for posed in self._images}):
            yield traversal_id, [n for n, posed in enumerate(self._images) if posed.traversal_id == traversal_id]

    def _confirm_image(self, number: int) -> ConfirmedDepth:
        """Compare the depth map of an image with those of its sources."""
        others = [
            self._read_posed_depth(other) for other in self._sources[number][: self._options.held_against].tolist()
        ]
        own = self._drop_below_ground(self._read_posed_depth(number))
        return confirm(own, others, max_share=self._options.agree_share, device=self._device)

    def _drop_below_ground(self, posed: PosedDepth) -> PosedDepth:
        """Remove depths below the ground: reflections in a wet road agree in all images."""
        row, column = np.nonzero(np.isfinite(posed.depth_m))
        pixels = np.column_stack([column + 0.5, row + 0.5, np.ones(len(row))])
        camera = (pixels @ np.linalg.inv(posed.K).T) * posed.depth_m[row, column].astype(np.float64)[:, None]
        depth = posed.depth_m.copy()
        if len(row):
            world = posed.world_SE3_camera.transform(camera).reshape(-1, 3)
            below = world[:, 2] < self._driven_ground.height(world[:, :2]) - _MAX_BELOW_M
            depth[row[below], column[below]] = np.nan
        return PosedDepth(depth, posed.K, posed.world_SE3_camera)

    def _read_posed_depth(self, number: int) -> PosedDepth:
        posed = self._images[number]
        return PosedDepth(self._read_depth(number), posed.lens.intrinsic_matrix(), posed.world_SE3_camera)

    def _read_depth(self, number: int) -> Float32:
        """Read a depth map of the work folder, through a cache.

        Raises:
            DatasetError: the file cannot be decoded.
        """
        return self._depth_cache.get(number, lambda: self._decode_depth(number), lambda depth: 1)

    def _decode_depth(self, number: int) -> Float32:
        file = self._raw_file(number)
        depth = decode_depth(file.read_bytes())
        if depth is None:
            raise DatasetError("the depth map cannot be decoded", file=file, remedy="delete it and run again")
        return depth

    def _raw_file(self, number: int) -> Path:
        """The file of an image's depth before fusion; it is named by the content of the images that it comes from."""
        if number not in self._raw_files:
            posed = self._images[number]
            others = self._sources[number][: self._options.sources].tolist()
            digest = hash_values(self._rigs, [self._hash(other) for other in (number, *others)])[:32]
            name = f"{posed.image.camera}/{posed.image.timestamp_ns}.{digest}.png"
            self._raw_files[number] = self._layers.work_folder / posed.traversal_id / name
        return self._raw_files[number]

    def _hash(self, number: int) -> str | None:
        """The hash of an image; None: it cannot be read."""
        if number not in self._image_hashes:
            try:
                self._image_hashes[number] = self._hashes.image(self._images[number].image)
            except DatasetError:
                self._image_hashes[number] = None
        return self._image_hashes[number]

    def _classify(self, position: Float64, ground: FittedGround) -> AnyArray:
        """Classify points (N, 3) as ground, far or background."""
        from scipy.spatial import cKDTree

        kind = np.full(len(position), "background", dtype="<U10")
        if len(position):
            kind[np.abs(position[:, 2] - ground.height(position[:, :2])) < _GROUND_M] = "ground"
            distance, _ = cKDTree(self._driven[:, :2]).query(position[:, :2])
            kind[distance > self._options.far_from_m] = "far"
        return kind

    def _read_points(self, traversal_id: str) -> PointCloud:
        table = read_table(self._layers.folder(traversal_id, "points") / "points.parquet", POINTS)
        columns = {name: table.column(name).to_numpy() for name in ("x_m", "y_m", "z_m", "r", "g", "b", "views")}
        return PointCloud(
            np.stack([columns[name] for name in ("x_m", "y_m", "z_m")], axis=1),
            np.stack([columns[name] for name in ("r", "g", "b")], axis=1),
            columns["views"].astype(np.int32),
            table.column("sigma_m").to_numpy().astype(np.float32),
        )


def _make_key(posed: PosedImage) -> dict[str, Any]:
    return {"camera": posed.image.camera, "timestamp_ns": posed.image.timestamp_ns}


def _lens_columns(posed: PosedImage) -> dict[str, Any]:
    names = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
    return {name: getattr(posed.lens, name) for name in names}


def _file_name(posed: PosedImage) -> str:
    return f"{posed.image.camera}/{posed.image.timestamp_ns}.png"


def _make_point_table(cloud: PointCloud, kind: AnyArray) -> pa.Table:
    columns: dict[str, AnyArray | pa.Array] = {"point": np.arange(len(cloud), dtype=np.int32)}
    columns |= {name: cloud.position_m[:, axis] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
    columns |= {name: cloud.rgb[:, channel] for channel, name in enumerate("rgb")}
    columns |= {"kind": pa.array(kind.tolist(), pa.string()), "views": cloud.views.astype(np.int16)}
    columns["sigma_m"] = pa.array(cloud.sigma_m, from_pandas=True)
    return pa.table(columns)


def _distort_mask(mask: Bool, posed: PosedImage) -> Bool:
    """Resample a mask from the undistorted to the recorded raster; False outside the undistorted raster."""
    lens = posed.image.camera_model
    u, v = posed.lens.undistort_maps(lens)
    resampled = cv2.remap(mask.astype(np.uint8), u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(resampled > 0)


def _encode_png(mask: Bool) -> bytes:
    return bytes(cv2.imencode(".png", mask.astype(np.uint8) * 255)[1])
