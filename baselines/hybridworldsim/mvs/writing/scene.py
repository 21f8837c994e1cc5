"""One scene's initialisation: its shots, their depth, what others confirm of it, and the points."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pyarrow as pa

from hybridworldsim.mvs.estimator import DepthEstimator
from hybridworldsim.mvs.fusion import ConfirmedDepth, PointCloud, PosedDepth, VoxelThinner, confirm, make_point_cloud
from hybridworldsim.mvs.ground import Ground, compute_wheel_contacts, fit_ground, read_driven_poses
from hybridworldsim.mvs.images.pairs import choose_sources
from hybridworldsim.mvs.images.posed_images import PosedImage, StereoImageCache, list_posed_images
from hybridworldsim.mvs.methods import MIN_CONFIDENCE
from hybridworldsim.mvs.options import InitialisationOptions
from hybridworldsim.mvs.sky import find_sky
from hybridworldsim.mvs.sparse import triangulate
from hybridworldsim.mvs.writing.layers import InitialisationLayers
from mirror.arrays import AnyArray, Bool, Float32, Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.pictures.depth import decode_depth, encode_depth
from mirror.errors import DatasetError
from mirror.methods.training_images import Picture
from mirror.progress import ProgressReporter
from mirror.schema.files import read_table, write_bytes
from mirror.schema.tables import DEPTH, MASKS, POINTS

_MAPS_HELD: Final = 512
_GROUND_M: Final = 0.2
_BELOW_M: Final = 0.4


class SceneInitialisation:
    """One scene's shots, and the maps that are made of them.

    Args:
        view: the scene's training traversals.
        layers: to be written.
        options: how.
        withheld: pictures that are not opened.
        progress: told of the phases.

    Attributes:
        counts: points written, by kind.
    """

    def __init__(
        self,
        view: Dataset,
        layers: InitialisationLayers,
        options: InitialisationOptions,
        withheld: Set[Picture],
        progress: ProgressReporter,
    ) -> None:
        self._layers, self._options, self._progress = layers, options, progress
        self._shots = list_posed_images(view, options.pixels, withheld, options.standing_m)
        self._pictures = StereoImageCache(self._shots, options.pixels)
        self._sources = choose_sources(self._shots, max(options.sources, options.held_against))
        self._held: OrderedDict[int, Float32] = OrderedDict()
        self._driven = compute_wheel_contacts(read_driven_poses(view))
        self._level = fit_ground(self._driven)
        self.counts: dict[str, int] = {}

    def estimate(self, estimator: DepthEstimator) -> int:
        """Estimate the depth of all pictures; how many.

        Each map is a file of its own, which an interrupted run leaves behind for the next.
        """
        options = self._options
        todo = [number for number, shot in enumerate(self._shots) if not self._raw(shot).is_file()]
        self._progress.start("depth", len(todo))
        for number in todo:
            sources = [self._pictures[other] for other in self._sources[number][: options.sources].tolist()]
            found = estimator(self._pictures[number], sources, options.near_m, options.far_m)
            sure = found.confidence >= self._least_confidence
            write_bytes(self._raw(self._shots[number]), encode_depth(np.where(sure, found.depth_m, np.nan)))
            self._progress.advance(1)
        return len(todo)

    def confirm(self) -> tuple[dict[str, PointCloud], tuple[int, int]]:
        """Write confirmed depth maps and sky masks.

        Returns:
            The thinned points by traversal; and of the maps that were written the pixels with a depth, and all that
            show what stands still.
        """
        self._progress.start("fusion", len(self._shots))
        voxels = VoxelThinner(self._options.voxel_m)
        clouds: dict[str, PointCloud] = {}
        known, static = 0, 0
        for traversal_id, numbers in self._by_traversal():
            if self._layers.has(traversal_id, "points"):
                clouds[traversal_id] = voxels.thin(self._read_points(traversal_id))
                self._progress.advance(len(numbers))
                continue
            clouds[traversal_id], share = self._confirm_traversal(traversal_id, numbers, voxels)
            known, static = known + share[0], static + share[1]
        return clouds, (known, static)

    def _confirm_traversal(
        self, traversal_id: str, numbers: Sequence[int], voxels: VoxelThinner
    ) -> tuple[PointCloud, tuple[int, int]]:
        depth, masks = self._layers.writer(traversal_id, "depth"), self._layers.writer(traversal_id, "masks")
        parts: list[PointCloud] = []
        depth_rows: list[dict[str, Any]] = []
        mask_rows: list[dict[str, Any]] = []
        known, static = 0, 0
        for number in numbers:
            shot, picture = self._shots[number], self._pictures[number]
            found = self._confirmed(number)
            agreed = found.views >= self._options.depth_views
            sure = np.where(agreed, found.depth_m, np.nan).astype(np.float32)
            known, static = known + int(agreed.sum()), static + int(picture.valid.sum())
            cloud = make_point_cloud(found, picture.rgb, picture.K, shot.world_SE3_camera, self._options.point_views)
            parts.append(voxels.thin(cloud))
            if depth is not None:
                depth_rows.append({**_key(shot), **_lens(shot), **depth.file(_name(shot), encode_depth(sure))})
            if masks is not None:
                mask = _as_recorded(find_sky(picture, sure), shot)
                mask_rows.append({**_key(shot), "kind": "sky", **masks.file(_name(shot), _png(mask))})
            self._progress.advance(1)
        if depth is not None:
            depth.finish(DEPTH, depth_rows, self._layers.made_of)
        if masks is not None:
            masks.finish(MASKS, mask_rows, self._layers.made_of)
        return PointCloud.concatenate(parts), (known, static)

    def triangulate(self) -> dict[str, PointCloud]:
        """Sparse points by the traversal that sees each first."""
        self._progress.start("sparse points", 1)
        found = triangulate(self._pictures.__getitem__, [own[: self._options.sources] for own in self._sources])
        owner = np.array([self._shots[first].traversal_id for first in found.first.tolist()], dtype=object)
        self._progress.advance(1)
        return {traversal_id: found.cloud.only(owner == traversal_id) for traversal_id, _ in self._by_traversal()}

    def write_points(self, clouds: Mapping[str, PointCloud]) -> Ground:
        """Fit the ground, and write the layers of points with their kinds."""
        every = PointCloud.concatenate(list(clouds.values()))
        ground = fit_ground(self._driven, every.position_m)
        for traversal_id, cloud in clouds.items():
            kind = self._kinds(cloud.position_m, ground)
            for name, count in zip(*np.unique(kind, return_counts=True)):
                self.counts[str(name)] = self.counts.get(str(name), 0) + int(count)
            writer = self._layers.writer(traversal_id, "points")
            if writer is not None:
                writer.finish(POINTS, _rows(cloud, kind), self._layers.made_of)
        return ground

    @property
    def _least_confidence(self) -> float:
        own = self._options.least_confidence
        return MIN_CONFIDENCE.get(self._layers.source, 0.0) if own is None else own

    def _by_traversal(self) -> Iterator[tuple[str, list[int]]]:
        for traversal_id in sorted({shot.traversal_id for shot in self._shots}):
            yield traversal_id, [n for n, shot in enumerate(self._shots) if shot.traversal_id == traversal_id]

    def _confirmed(self, number: int) -> ConfirmedDepth:
        others = [self._posed(other) for other in self._sources[number][: self._options.held_against].tolist()]
        return confirm(self._above_ground(self._posed(number)), others, most_share=self._options.agree_share)

    def _above_ground(self, one: PosedDepth) -> PosedDepth:
        """A map without the depths that lie below the ground: what a wet road mirrors agrees in all pictures."""
        row, column = np.nonzero(np.isfinite(one.depth_m))
        pixels = np.column_stack([column + 0.5, row + 0.5, np.ones(len(row))])
        camera = (pixels @ np.linalg.inv(one.K).T) * one.depth_m[row, column].astype(np.float64)[:, None]
        depth = one.depth_m.copy()
        if len(row):
            world = one.world_SE3_camera.transform(camera).reshape(-1, 3)
            below = world[:, 2] < self._level.height(world[:, :2]) - _BELOW_M
            depth[row[below], column[below]] = np.nan
        return PosedDepth(depth, one.K, one.world_SE3_camera)

    def _posed(self, number: int) -> PosedDepth:
        shot = self._shots[number]
        return PosedDepth(self._map(number), shot.lens.intrinsic_matrix(), shot.world_SE3_camera)

    def _map(self, number: int) -> Float32:
        if number not in self._held:
            file = self._raw(self._shots[number])
            depth = decode_depth(file.read_bytes())
            if depth is None:
                raise DatasetError("a depth map is broken", file=file, remedy="delete the file and run again")
            self._held[number] = depth
            if len(self._held) > _MAPS_HELD:
                self._held.popitem(last=False)
        self._held.move_to_end(number)
        return self._held[number]

    def _raw(self, shot: PosedImage) -> Path:
        return self._layers.work / shot.traversal_id / _name(shot)

    def _kinds(self, position: Float64, ground: Ground) -> AnyArray:
        from scipy.spatial import cKDTree

        kind = np.full(len(position), "background", dtype="<U10")
        if len(position):
            kind[np.abs(position[:, 2] - ground.height(position[:, :2])) < _GROUND_M] = "ground"
            away, _ = cKDTree(self._driven[:, :2]).query(position[:, :2])
            kind[away > self._options.far_from_m] = "far"
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


def _key(shot: PosedImage) -> dict[str, Any]:
    return {"camera": shot.image.camera, "timestamp_ns": shot.image.timestamp_ns}


def _lens(shot: PosedImage) -> dict[str, Any]:
    names = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
    return {name: getattr(shot.lens, name) for name in names}


def _name(shot: PosedImage) -> str:
    return f"{shot.image.camera}/{shot.image.timestamp_ns}.png"


def _rows(cloud: PointCloud, kind: AnyArray) -> pa.Table:
    columns: dict[str, AnyArray | pa.Array] = {"point": np.arange(len(cloud), dtype=np.int32)}
    columns |= {name: cloud.position_m[:, axis] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
    columns |= {name: cloud.rgb[:, channel] for channel, name in enumerate("rgb")}
    columns |= {"kind": pa.array(kind.tolist(), pa.string()), "views": cloud.views.astype(np.int16)}
    columns["sigma_m"] = pa.array(cloud.sigma_m, from_pandas=True)
    return pa.table(columns)


def _as_recorded(mask: Bool, shot: PosedImage) -> Bool:
    """A mask of the undistorted raster in that of the recorded picture; False where the former sees nothing."""
    lens = shot.image.camera_model
    u, v = shot.lens.undistort_maps(lens)
    found = cv2.remap(mask.astype(np.uint8), u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(found > 0)


def _png(mask: Bool) -> bytes:
    return bytes(cv2.imencode(".png", mask.astype(np.uint8) * 255)[1])
