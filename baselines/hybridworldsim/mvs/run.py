"""Initialises a reconstruction: depth maps, points and sky masks of a split's training traversals, as layers."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pyarrow as pa

from hybridworldsim.mvs.estimator import DepthEstimator
from hybridworldsim.mvs.fusion import Cloud, Confirmed, PosedDepth, Voxels, cloud_of, confirm
from hybridworldsim.mvs.ground import Ground, fit_ground
from hybridworldsim.mvs.pairs import choose_sources
from hybridworldsim.mvs.shots import Pictures, Shot, shots_of
from hybridworldsim.mvs.sky import sky_mask
from mirror.arrays import AnyArray, Bool, Float32, Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import read_manifest
from mirror.dataset.lock import writer_lock
from mirror.dataset.pictures.depth import decode_depth, encode_depth
from mirror.errors import DatasetError
from mirror.evaluation.progress import Progress, Silent
from mirror.evaluation.protocol import Pixels
from mirror.schema.files import read_table, write_bytes
from mirror.schema.tables import DEPTH, MASKS, POINTS

_KINDS: Final = {"depth": DEPTH, "masks": MASKS, "points": POINTS}
_WORK: Final = ".mvs"
_MAPS_HELD: Final = 512
_GROUND_M: Final = 0.2


@dataclass(frozen=True)
class Options:
    """How a reconstruction is initialised.

    Attributes:
        width_px: widest raster of the pictures that are matched.
        sources: pictures that each picture is matched with.
        held_against: pictures that each depth map is held against.
        near_m: smallest depth searched.
        far_m: largest depth searched.
        least_confidence: an estimate below it is unknown.
        depth_views: a depth is written if so many pictures agree on it, its own included.
        point_views: a point is made of it if so many agree.
        voxel_m: side of the cells that hold one point each.
        far_from_m: points farther than this from all driven lines are of kind ``far``.
        sky: whether masks of the sky are made.
    """

    width_px: int = 240
    sources: int = 4
    held_against: int = 8
    near_m: float = 2.0
    far_m: float = 200.0
    least_confidence: float = 0.1
    depth_views: int = 2
    point_views: int = 3
    voxel_m: float = 0.1
    far_from_m: float = 60.0
    sky: bool = True

    @property
    def pixels(self) -> Pixels:
        """The raster of the depth maps."""
        return Pixels(space="undistorted", max_width_px=self.width_px)


@dataclass(frozen=True)
class Initialised:
    """What an initialisation did.

    Attributes:
        layer: ``source@version`` of the layers.
        written: traversals whose layers were written.
        kept: traversals whose layers were there already.
        pictures: pictures whose depth was estimated.
        known_share: share of their static pixels with a confirmed depth.
        points: points in the layers of all the traversals, by kind.
        ground_sigma_m: how far the driven lines are from the ground that was fitted, by scene.
    """

    layer: str
    written: tuple[str, ...]
    kept: tuple[str, ...]
    pictures: int
    known_share: float
    points: Mapping[str, int]
    ground_sigma_m: Mapping[str, float] = field(default_factory=dict)


def initialise(
    dataset: Dataset,
    split: str,
    estimator: DepthEstimator,
    *,
    source: str,
    version: str | None = None,
    options: Options = Options(),
    made_by: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> Initialised:
    """Write layers of depth, points and sky masks for the training traversals of a split.

    Held-out traversals are not read: neither their pictures nor their poses. A run that was interrupted goes on where
    it stopped; the outcome is the same. Memory: at most 512 depth maps and 256 pictures, and the points of one scene.

    Args:
        dataset: a local dataset.
        split: its split.
        estimator: of depth.
        source: name of the layers, for example that of the estimator.
        version: of the layers; None: the name of the split, as other training traversals give other layers.
        options: how.
        made_by: hashes of what the estimator is made of, for the manifests.
        progress: told of the phases.

    Raises:
        DatasetError: the layers are there, but were made of other traversals or in another way.
        UsageError: there is no such split, or the dataset is not local.
    """
    view = dataset.where(split=split, role="train")
    run = _Run(view, source, version or split, options, dict(made_by or {}), progress or Silent())
    with writer_lock(run.layout, wait=False):
        report = run.all_scenes(estimator)
        run.phase("index", 1)
        build_index(run.layout.root)
    return report


class _Run:
    def __init__(
        self, view: Dataset, source: str, version: str, options: Options, made_by: dict[str, str], progress: Progress
    ) -> None:
        self.layout, self.view, self.source, self.version = view.layout, view, source, version
        self.options, self.progress = options, progress
        self.advance, self.phase = progress.advance, progress.start
        self.derived_from = made_by | {"options": _digest(vars(options))}
        for traversal_id in view.traversals():
            manifest = read_manifest(self.layout.recorded(traversal_id))
            if manifest is None:
                raise DatasetError("not complete", file=self.layout.recorded(traversal_id))
            self.derived_from[f"traversal:{traversal_id}"] = manifest.content
        self.work = self.layout.root / _WORK / f"{source}@{version}"
        self.kinds = [kind for kind in _KINDS if options.sky or kind != "masks"]

    def all_scenes(self, estimator: DepthEstimator) -> Initialised:
        kept = tuple(one for one in self.view.traversals() if self._complete(one))
        written = tuple(one for one in self.view.traversals() if one not in kept)
        counts: dict[str, int] = dict.fromkeys(("ground", "background", "far"), 0)
        sigma, pictures, known, static = {}, 0, 0, 0
        for scene in self.view.scenes():
            own = self.view.where(scene=scene)
            if all(one in kept for one in own.traversals()):
                continue
            one = _Scene(self, own, kept)
            pictures += one.estimate(estimator)
            clouds, seen = one.confirm_all()
            known, static = known + seen[0], static + seen[1]
            ground = one.write_points(clouds, counts)
            sigma[scene] = ground.sigma_m
        if self.work.exists():
            shutil.rmtree(self.work)
        share = known / static if static else 0.0
        return Initialised(f"{self.source}@{self.version}", written, kept, pictures, share, counts, sigma)

    def layer(self, traversal_id: str, kind: str) -> Path:
        return self.layout.layer(traversal_id, kind, self.source, self.version)

    def has(self, traversal_id: str, kind: str) -> bool:
        """Whether a layer is there; one that was made of something else is refused."""
        manifest = read_manifest(self.layer(traversal_id, kind))
        if manifest is None:
            return False
        own = {key: value for key, value in manifest.derived_from.items() if key != "recorded"}
        if own != self.derived_from:
            differing = sorted(set(own.items()) ^ set(self.derived_from.items()))[0][0]
            raise DatasetError(
                f"the layer was made of something else: {differing} differs",
                file=self.layer(traversal_id, kind),
                remedy="write these layers side by side: choose another --version",
            )
        return True

    def _complete(self, traversal_id: str) -> bool:
        return all(self.has(traversal_id, kind) for kind in self.kinds)


class _Scene:
    """One scene's shots, and the maps that are made of them."""

    def __init__(self, run: _Run, view: Dataset, kept: Sequence[str]) -> None:
        self.run, self.view, self.kept = run, view, kept
        self.shots = shots_of(view, run.options.pixels)
        self.pictures = Pictures(self.shots, run.options.pixels)
        self.sources = choose_sources(self.shots, max(run.options.sources, run.options.held_against))
        self.held: OrderedDict[int, Float32] = OrderedDict()

    def estimate(self, estimator: DepthEstimator) -> int:
        """Estimate the depth of all pictures, each into a file of its own that an interrupted run leaves behind."""
        options = self.run.options
        todo = [number for number, shot in enumerate(self.shots) if not self._raw(shot).is_file()]
        self.run.phase("depth", len(todo))
        for number in todo:
            sources = [self.pictures[other] for other in self.sources[number][: options.sources].tolist()]
            found = estimator(self.pictures[number], sources, options.near_m, options.far_m)
            unsure = ~(found.confidence >= options.least_confidence)
            write_bytes(self._raw(self.shots[number]), encode_depth(np.where(unsure, np.nan, found.depth_m)))
            self.run.advance(1)
        return len(todo)

    def confirm_all(self) -> tuple[dict[str, Cloud], tuple[int, int]]:
        """Write confirmed depth maps and sky masks; the thinned points come back by traversal."""
        self.run.phase("fusion", len(self.shots))
        voxels, clouds, known, static = Voxels(self.run.options.voxel_m), {}, 0, 0
        for traversal_id, numbers in self._by_traversal():
            if self.run.has(traversal_id, "points"):
                clouds[traversal_id] = voxels.thin(self._read_points(traversal_id))
                self.run.advance(len(numbers))
                continue
            depth = self._writer(traversal_id, "depth")
            masks = self._writer(traversal_id, "masks") if self.run.options.sky else None
            parts, depth_rows, mask_rows = [], [], []
            for number in numbers:
                shot, picture = self.shots[number], self.pictures[number]
                found = self._confirmed(number)
                sure = np.where(found.views >= self.run.options.depth_views, found.depth_m, np.nan).astype(np.float32)
                known, static = known + int(np.isfinite(sure).sum()), static + int(picture.valid.sum())
                parts.append(
                    voxels.thin(
                        cloud_of(found, picture.rgb, picture.K, shot.world_SE3_camera, self.run.options.point_views)
                    )
                )
                if depth is not None:
                    depth_rows.append({**_key(shot), **_lens(shot), **depth.file(_name(shot), encode_depth(sure))})
                if masks is not None:
                    mask = _as_recorded(sky_mask(picture, sure), shot)
                    mask_rows.append({**_key(shot), "kind": "sky", **masks.file(_name(shot), _png(mask))})
                self.run.advance(1)
            for writer, table, rows in ((depth, DEPTH, depth_rows), (masks, MASKS, mask_rows)):
                if writer is not None:
                    writer.finish(table, rows, self.run.derived_from)
            clouds[traversal_id] = Cloud.together(parts)
        return clouds, (known, static)

    def write_points(self, clouds: Mapping[str, Cloud], counts: dict[str, int]) -> Ground:
        """Fit the ground, and write the layers of points with their kinds."""
        driven = self._driven()
        every = Cloud.together(list(clouds.values()))
        ground = fit_ground(driven, every.position_m[every.views >= self.run.options.point_views])
        for traversal_id, cloud in clouds.items():
            kind = self._kinds(cloud.position_m, ground, driven)
            for name, count in zip(*np.unique(kind, return_counts=True)):
                counts[str(name)] += int(count)
            writer = self._writer(traversal_id, "points")
            if writer is not None:
                writer.finish(POINTS, _rows(cloud, kind), self.run.derived_from)
        return ground

    def _writer(self, traversal_id: str, kind: str) -> LayerWriter | None:
        """A writer of a layer; None: it is there."""
        if self.run.has(traversal_id, kind):
            return None
        return LayerWriter(self.run.layout, traversal_id, kind, self.run.source, self.run.version)

    def _by_traversal(self) -> Iterator[tuple[str, list[int]]]:
        for traversal_id in sorted({shot.traversal_id for shot in self.shots}):
            yield traversal_id, [n for n, shot in enumerate(self.shots) if shot.traversal_id == traversal_id]

    def _confirmed(self, number: int) -> Confirmed:
        others = [self._posed(other) for other in self.sources[number][: self.run.options.held_against].tolist()]
        return confirm(self._posed(number), others)

    def _posed(self, number: int) -> PosedDepth:
        shot = self.shots[number]
        return PosedDepth(self._map(number), shot.lens.intrinsic_matrix(), shot.world_SE3_camera)

    def _map(self, number: int) -> Float32:
        if number not in self.held:
            file = self._raw(self.shots[number])
            depth = decode_depth(file.read_bytes())
            if depth is None:
                raise DatasetError("a depth map is broken", file=file, remedy="delete the file and run again")
            self.held[number] = depth
            if len(self.held) > _MAPS_HELD:
                self.held.popitem(last=False)
        self.held.move_to_end(number)
        return self.held[number]

    def _raw(self, shot: Shot) -> Path:
        return self.run.work / shot.traversal_id / _name(shot)

    def _driven(self) -> Float64:
        rows = self.view.table("ego_poses", ["tx_m", "ty_m", "tz_m"])
        return np.stack([column.to_numpy() for column in rows.columns], axis=1)

    def _kinds(self, position: Float64, ground: Ground, driven: Float64) -> AnyArray:
        from scipy.spatial import cKDTree

        kind = np.full(len(position), "background", dtype="<U10")
        if len(position):
            kind[np.abs(position[:, 2] - ground.height(position[:, :2])) < _GROUND_M] = "ground"
            away, _ = cKDTree(driven[:, :2]).query(position[:, :2])
            kind[away > self.run.options.far_from_m] = "far"
        return kind

    def _read_points(self, traversal_id: str) -> Cloud:
        table = read_table(self.run.layer(traversal_id, "points") / "points.parquet", POINTS)
        columns = {name: table.column(name).to_numpy() for name in ("x_m", "y_m", "z_m", "r", "g", "b", "views")}
        return Cloud(
            np.stack([columns[name] for name in ("x_m", "y_m", "z_m")], axis=1),
            np.stack([columns[name] for name in ("r", "g", "b")], axis=1),
            columns["views"].astype(np.int32),
            table.column("sigma_m").to_numpy().astype(np.float32),
        )


def _key(shot: Shot) -> dict[str, Any]:
    return {"camera": shot.image.camera, "timestamp_ns": shot.image.timestamp_ns}


def _lens(shot: Shot) -> dict[str, Any]:
    names = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
    return {name: getattr(shot.lens, name) for name in names}


def _name(shot: Shot) -> str:
    return f"{shot.image.camera}/{shot.image.timestamp_ns}.png"


def _rows(cloud: Cloud, kind: AnyArray) -> pa.Table:
    columns: dict[str, AnyArray | pa.Array] = {"point": np.arange(len(cloud), dtype=np.int32)}
    columns |= {name: cloud.position_m[:, axis] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
    columns |= {name: cloud.rgb[:, channel] for channel, name in enumerate("rgb")}
    columns |= {"kind": pa.array(kind.tolist(), pa.string()), "views": cloud.views.astype(np.int16)}
    columns["sigma_m"] = pa.array(cloud.sigma_m, from_pandas=True)
    return pa.table(columns)


def _as_recorded(mask: Bool, shot: Shot) -> Bool:
    """A mask of the undistorted raster in that of the recorded picture; False where the former sees nothing."""
    lens = shot.image.camera_model
    u, v = shot.lens.undistort_maps(lens)
    found = cv2.remap(mask.astype(np.uint8), u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(found > 0)


def _png(mask: Bool) -> bytes:
    return bytes(cv2.imencode(".png", mask.astype(np.uint8) * 255)[1])


def _digest(values: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(dict(values), sort_keys=True).encode()).hexdigest()
