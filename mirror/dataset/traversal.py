"""One traversal for the loaders: its poses, calibrations, boxes and image rows in the chosen layers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Bool, Float64, Int64
from mirror.dataset.layers import LayerChoice
from mirror.dataset.lidars import LIDAR_LAYER, LidarFiles, read_lidar_files
from mirror.dataset.query.arrow import floats_or_nan, is_member, is_valid, to_arrow_mask, to_arrow_rows, to_numpy
from mirror.dataset.query.catalog import Catalog
from mirror.dataset.row_index import RowIndex
from mirror.errors import DatasetError, UsageError
from mirror.geometry.cameras import Camera, camera_from_row
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.schema.files import parse_json
from mirror.schema.references import REFERENCES, ImageReferences
from mirror.schema.tables import BOXES, CALIBRATIONS, DEPTH, EGO_POSES, IMAGES, MASKS

STAGES: Final = ("refined", "online", "factory")
_POSE: Final = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
_IMAGE: Final = tuple(name for name in IMAGES.schema.names if name != "frame_index")


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """One camera's calibration over a validity interval.

    Attributes:
        camera: the camera's name.
        stage: factory, online or refined.
        valid_from_ns: first valid time, Unix; None: valid from the beginning.
        valid_to_ns: last valid time, Unix; None: valid without end.
        model: intrinsics.
        ego_SE3_camera: mounting of the camera on the vehicle, one pose.
        row: all columns of the calibration's row.
    """

    camera: str
    stage: str
    valid_from_ns: int | None
    valid_to_ns: int | None
    model: Camera
    ego_SE3_camera: Poses
    row: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class FrameBoxes:
    """The N boxes at one time.

    Attributes:
        frame: the frame that the poses map into: ``ego`` (at ``timestamp_ns``), ``world`` or ``camera:<name>``.
        timestamp_ns: time of the boxes, Unix.
        pose: N poses ``frame_SE3_box``.
        size_m: (N, 3) length, width, height, along the box's x, y and z.
        velocity_mps: (N, 3) velocity over ground along the frame's axes; NaN where unknown.
        category: N class names.
        track_id: N object ids.
        score: (N,) confidence; NaN for a label without one.
        source: N names ``source@version``.
        attributes: N lists of the object's states in the source's own words; empty where it states none.
    """

    frame: str
    timestamp_ns: int
    pose: Poses
    size_m: Float64
    velocity_mps: Float64
    category: tuple[str, ...]
    track_id: tuple[str, ...]
    score: Float64
    source: tuple[str, ...]
    attributes: tuple[tuple[str, ...], ...]

    def __len__(self) -> int:
        return len(self.pose)

    def to_frame(self, frame: str, frame_SE3_ego: Poses) -> FrameBoxes:
        """Map the boxes into another frame.

        Args:
            frame: name of the frame.
            frame_SE3_ego: one pose of the ego frame in it.
        """
        turn = Poses(frame_SE3_ego.rotation, np.zeros((1, 3)))
        velocity = turn.transform(self.velocity_mps)[0] if len(self) else self.velocity_mps
        return FrameBoxes(
            frame,
            self.timestamp_ns,
            frame_SE3_ego @ self.pose,
            self.size_m,
            velocity,
            self.category,
            self.track_id,
            self.score,
            self.source,
            self.attributes,
        )


class Traversal:
    """The loaded tables of one traversal; each is read once.

    Args:
        catalog: the index.
        row: row of the traversal in the table of traversals.
        traversal_id: its id.
        layers: the layers to read.
    """

    def __init__(self, catalog: Catalog, row: int, traversal_id: str, layers: LayerChoice) -> None:
        self._catalog = catalog
        self.row = row
        self._layers = layers
        self.traversal_id = traversal_id

    @cached_property
    def etags(self) -> Mapping[str, str]:
        """ETags of the images outside of the dataset, by uri; empty where none is known."""
        path = f"traversals/{self.traversal_id}/recorded/{REFERENCES}"
        store = self._catalog.store
        found = store.read_many([path])
        return parse_json(found[path], ImageReferences, store.full_path(path)).etags if path in found else {}

    @cached_property
    def track(self) -> tuple[Int64, Poses]:
        """Timestamps (N,) and N poses ``world_SE3_ego`` of the chosen pose layer.

        Raises:
            DatasetError: this traversal lacks the chosen layer.
        """
        columns = ["timestamp_ns", *_POSE]
        arrays = self._table("poses", self._layers.poses, EGO_POSES.name, columns)
        values = [to_numpy(array) for array in arrays]
        return values[0], Poses(np.stack(values[1:5], axis=1), np.stack(values[5:], axis=1))

    def world_SE3_ego(self, timestamp_ns: npt.ArrayLike) -> Poses:  # noqa: N802
        """Interpolate the ego pose at times (M,), Unix ns.

        Raises:
            DatasetError: the poses do not cover a time.
        """
        stamps, poses = self.track
        try:
            return interpolate(stamps, poses, timestamp_ns)
        except UsageError as error:
            raise DatasetError(
                error.problem,
                file=f"traversals/{self.traversal_id}",
                place=f"poses of layer {self._layers.poses}",
                expected="poses before and after every image",
                remedy="name another layer of poses, or write this one again for all images",
            ) from error

    @cached_property
    def calibrations(self) -> Sequence[CameraCalibration]:
        """All calibrations of the chosen layer, sorted by camera, stage and validity."""
        names = CALIBRATIONS.schema.names
        arrays = self._table("calibrations", self._layers.calibrations, CALIBRATIONS.name, names)
        rows = pa.Table.from_arrays(list(arrays), names=names).to_pylist()
        return [
            CameraCalibration(
                camera=row["camera"],
                stage=row["stage"],
                valid_from_ns=row["valid_from_ns"],
                valid_to_ns=row["valid_to_ns"],
                model=camera_from_row(row),
                ego_SE3_camera=Poses(
                    np.array([[row[name] for name in _POSE[:4]]]), np.array([[row[name] for name in _POSE[4:]]])
                ),
                row=row,
            )
            for row in rows
        ]

    def calibration(self, camera: str, timestamp_ns: int) -> CameraCalibration:
        """Return the calibration of a camera that is valid at a time.

        Raises:
            DatasetError: no calibration is valid at that time.
        """
        valid = [
            item
            for item in self.calibrations
            if item.camera == camera
            and (item.valid_from_ns is None or item.valid_from_ns <= timestamp_ns)
            and (item.valid_to_ns is None or timestamp_ns <= item.valid_to_ns)
        ]
        for stage in STAGES if self._layers.stage is None else (self._layers.stage,):
            of_stage = [item for item in valid if item.stage == stage]
            if of_stage:
                return of_stage[-1]
        stages = sorted({item.stage for item in self.calibrations if item.camera == camera})
        raise DatasetError(
            f"no calibration of camera {camera} is valid at {timestamp_ns}",
            file=f"traversals/{self.traversal_id}",
            place=f"calibrations of layer {self._layers.calibrations}",
            expected=f"stage {self._layers.stage}" if self._layers.stage else "a row valid at that time",
            remedy=f"choose one of its stages: {', '.join(stages)}" if stages else "calibrate the camera",
        )

    def image_rows(self, frame_index: int) -> Sequence[Mapping[str, Any]]:
        """Return the rows of the images of one frame, in no particular order."""
        group = self._group("images")
        if group is None:
            return []
        rows = self._frame_rows.rows(frame_index).tolist()
        arrays = self._catalog.columns.read(*group, _IMAGE)
        return [{name: array[row].as_py() for name, array in zip(_IMAGE, arrays)} for row in rows]

    @cached_property
    def _frame_rows(self) -> RowIndex:
        (index,) = self._read_group("images", ["frame_index"])
        # Images without a frame have no number; numbers are not negative.
        return RowIndex(np.where(is_valid(index), to_numpy(index), -1))

    def mask_rows(self, camera: str, timestamp_ns: int) -> Sequence[Mapping[str, Any]]:
        """Return the rows of the masks of one image."""
        group = self._group("masks")
        if group is None:
            return []
        names = MASKS.schema.names
        arrays = dict(zip(names, self._catalog.columns.read(*group, names)))
        rows = self._mask_times.rows(timestamp_ns).tolist()
        of_image = [row for row in rows if arrays["camera"][row].as_py() == camera]
        return [{name: arrays[name][row].as_py() for name in names} for row in of_image]

    @cached_property
    def _mask_times(self) -> RowIndex:
        (stamps,) = self._read_group("masks", ["timestamp_ns"])
        return RowIndex(to_numpy(stamps))

    def depth_row(self, camera: str, timestamp_ns: int) -> Mapping[str, Any] | None:
        """Return the row of an image's depth map in the chosen layer; None if the image has none.

        Raises:
            UsageError: the traversal has several depth layers and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        entry = self._depth.get((camera, timestamp_ns))
        if entry is None:
            return None
        columns, row = entry
        return {name: array[row].as_py() for name, array in columns.items()}

    @cached_property
    def _depth(self) -> Mapping[tuple[str, int], tuple[Mapping[str, pa.Array], int]]:
        names = DEPTH.schema.names
        self._require_listed("depth", self._layers.depth)
        group = self._group("depth")
        if group is None:
            return {}
        arrays = dict(zip(names, self._catalog.columns.read(*group, names)))
        rows = np.flatnonzero(self._of_layer("depth", arrays, self._layers.depth)).tolist()
        cameras, stamps = arrays["camera"].to_pylist(), arrays["timestamp_ns"].to_pylist()
        return {(cameras[row], stamps[row]): (arrays, row) for row in rows}

    def _of_layer(self, kind: str, arrays: Mapping[str, pa.Array], chosen: str | None) -> Bool:
        """Mask (N,) of the rows of a layer table that belong to the chosen layer."""
        return rows_of_layer(kind, self.traversal_id, arrays["source"], arrays["source_version"], chosen)

    def boxes(self, timestamp_ns: int) -> FrameBoxes:
        """Return the boxes of the stamp nearest to a time, in the ego frame at that stamp.

        Boxes are used if they are at most half a period of their layer away. A layer with a single time has no period:
        its boxes are used only at exactly that time.

        Raises:
            UsageError: the traversal has several box layers and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        times, table = self._boxes
        nearest = times.nearest(timestamp_ns)
        if nearest is None or 2 * abs(nearest - timestamp_ns) > times.step:
            return _frame_boxes(table, np.empty(0, np.int64), timestamp_ns)
        return _frame_boxes(table, times.rows(nearest), nearest)

    @cached_property
    def track_ids(self) -> tuple[str, ...]:
        """Ids of all objects in the chosen box layer, sorted.

        Raises:
            UsageError: the traversal has several box layers and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        _, table = self._boxes
        return tuple(sorted(set(table["track_id"].to_pylist()))) if table else ()

    @cached_property
    def _boxes(self) -> tuple[RowIndex, Mapping[str, pa.Array]]:
        names = BOXES.schema.names
        self._require_listed("boxes", self._layers.boxes)
        group = self._group("boxes")
        if group is None:
            return RowIndex(np.empty(0, np.int64)), {}
        arrays = dict(zip(names, self._catalog.columns.read(*group, names)))
        in_layer = self._of_layer("boxes", arrays, self._layers.boxes)
        table = {name: array.filter(to_arrow_mask(in_layer)) for name, array in arrays.items()}
        return RowIndex(to_numpy(table["timestamp_ns"])), table

    @cached_property
    def lidars(self) -> tuple[LidarFiles, ...]:
        """The lidar sweeps by sensor and format; empty where the source has none."""
        layers = self._catalog.read_global("traversals", ["layers"]).column(0)[self.row].as_py()
        return read_lidar_files(self._catalog.store, self.traversal_id) if LIDAR_LAYER in layers else ()

    def _group(self, name: str) -> tuple[str, int] | None:
        """File and position of this traversal's row group in an index table; None: it has no rows."""
        return self._catalog.group_of(name, self.row)

    def _read_group(self, name: str, columns: Sequence[str]) -> list[pa.Array]:
        """Read columns of this traversal's rows in an index table; empty ones where it has no rows."""
        group = self._group(name)
        return self._catalog.columns.read(*group, columns) if group else [pa.nulls(0) for _ in columns]

    def _table(self, kind: str, layer: str, name: str, columns: Sequence[str]) -> list[pa.Array]:
        """Read columns of a recorded table, or of the same table in a layer."""
        if layer == "recorded":
            return self._read_group(name, columns)
        self._require_listed(kind, layer)
        path = f"traversals/{self.traversal_id}/layers/{kind}/{layer}/{name}.parquet"
        return self._catalog.columns.read(path, 0, columns)

    def _require_listed(self, kind: str, layer: str | None) -> None:
        """Raise an error if a layer is chosen that this traversal lacks. A layer may have no rows."""
        if layer is None:
            return
        layers = self._catalog.read_global("traversals", ["layers"]).column(0)[self.row].as_py()
        if f"{kind}/{layer}" not in layers:
            raise missing_layer_error(kind, layer, f"traversals/{self.traversal_id}/layers/{kind}")


def rows_of_layer(kind: str, traversal_id: str, source: pa.Array, version: pa.Array, chosen: str | None) -> Bool:
    """Mark the rows (N,) of a traversal that belong to one of its layers.

    Args:
        kind: kind of the layers, for messages.
        traversal_id: the traversal.
        source: (N,) source of each row, N >= 1.
        version: (N,) version of the source.
        chosen: ``source@version``, which may have no rows; None: the only layer.

    Raises:
        UsageError: the rows are of several layers and none was chosen.
    """
    names = layer_names(source, version)
    layers = sorted(pc.unique(names).to_pylist())
    if chosen is None:
        if len(layers) > 1:
            raise UsageError(
                f"traversal {traversal_id} has {kind} of {', '.join(layers)}",
                remedy=f"name one (verbs that choose: --{kind} {layers[-1]}), or remove the others",
            )
        chosen = layers[0]
    return is_member(names, frozenset([chosen]))


def layer_names(source: pa.Array, version: pa.Array) -> pa.Array:
    """Return the names ``source@version`` (N,) from sources (N,) and their versions (N,)."""
    return pc.binary_join_element_wise(source.cast(pa.string()), version.cast(pa.string()), "@")


def missing_layer_error(kind: str, layer: str, where: str) -> DatasetError:
    """Make the error for a missing layer."""
    return DatasetError(
        f"there is no {kind} layer {layer}",
        file=where,
        expected="a complete layer of that name",
        remedy=f"name another layer of {kind}, or leave this traversal out",
    )


def _frame_boxes(table: Mapping[str, pa.Array], rows: Int64, timestamp_ns: int) -> FrameBoxes:
    # Not the column's conversion: with nulls, that works on all rows of the traversal.
    taken = to_arrow_rows(rows)

    def floats(*names: str) -> Float64:
        if not len(rows):
            return np.empty((0, len(names)))
        return np.stack([floats_or_nan(table[name].take(taken)) for name in names], axis=1)

    def strings(name: str) -> tuple[str, ...]:
        return tuple(table[name][row].as_py() for row in rows.tolist())

    return FrameBoxes(
        frame="ego",
        timestamp_ns=timestamp_ns,
        pose=Poses(floats(*_POSE[:4]), floats(*_POSE[4:])),
        size_m=floats("length_m", "width_m", "height_m"),
        velocity_mps=floats("vx_mps", "vy_mps", "vz_mps"),
        category=strings("category"),
        track_id=strings("track_id"),
        score=floats("score")[:, 0],
        source=tuple(f"{source}@{version}" for source, version in zip(strings("source"), strings("source_version"))),
        attributes=tuple(tuple(table["attributes"][row].as_py() or ()) for row in rows.tolist()),
    )
