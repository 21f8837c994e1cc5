"""One traversal as loaders see it: its poses, calibrations, boxes and picture rows under the chosen layers."""

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
from mirror.dataset.query.arrow import floats_or_nan, is_member, to_arrow_mask, to_numpy
from mirror.dataset.query.catalog import Catalog
from mirror.errors import DatasetError, UsageError
from mirror.geometry.cameras import Camera, camera_from_row
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.schema.tables import BOXES, CALIBRATIONS, DEPTH, EGO_POSES, IMAGES, MASKS

STAGES: Final = ("refined", "online", "factory")
_POSE: Final = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
_PICTURE: Final = tuple(name for name in IMAGES.schema.names if name != "frame_index")


@dataclass(frozen=True, eq=False)
class Calibration:
    """One camera's calibration over a validity interval.

    Attributes:
        camera: the camera's name.
        stage: factory, online or refined.
        valid_from_ns: first instant; None: from the beginning.
        valid_to_ns: last instant; None: without end.
        model: intrinsics.
        ego_SE3_camera: mounting, one pose.
        row: the whole row of the table.
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
    """The boxes at one instant.

    Attributes:
        frame: what the poses map into: ``ego`` (at ``timestamp_ns``), ``world`` or ``camera:<name>``.
        timestamp_ns: the instant that the boxes describe.
        pose: (N) poses, ``frame_SE3_box``.
        size_m: (N, 3) length, width, height, along the box's x, y and z.
        velocity_mps: (N, 3) over ground, along the frame's axes; NaN where unknown.
        category: (N) classes.
        track_id: (N) objects.
        score: (N,) confidence; NaN where the label has none.
        source: (N) ``source@version``.
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

    def __len__(self) -> int:
        return len(self.pose)

    def into(self, frame: str, frame_SE3_ego: Poses) -> FrameBoxes:
        """The same boxes in another frame, given one pose of the ego frame in it."""
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
        )


class Traversal:
    """What is loaded of one traversal, once.

    Args:
        catalog: the index.
        row: the traversal's row in the table of traversals.
        traversal_id: its id.
        layers: the layers to read.
    """

    def __init__(self, catalog: Catalog, row: int, traversal_id: str, layers: LayerChoice) -> None:
        self._catalog = catalog
        self.row = row
        self._layers = layers
        self.traversal_id = traversal_id

    @cached_property
    def track(self) -> tuple[Int64, Poses]:
        """Stamps (N,) and ``world_SE3_ego`` of the chosen pose layer.

        Raises:
            DatasetError: this traversal has no such layer.
        """
        columns = ["timestamp_ns", *_POSE]
        arrays = self._table("poses", self._layers.poses, EGO_POSES.name, columns)
        values = [to_numpy(array) for array in arrays]
        return values[0], Poses(np.stack(values[1:5], axis=1), np.stack(values[5:], axis=1))

    def world_SE3_ego(self, timestamp_ns: npt.ArrayLike) -> Poses:  # noqa: N802
        """The ego's pose at any times (M,) of the traversal.

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
                expected="poses before and after every picture",
                remedy="choose another pose layer: with_layers(poses=...)",
            ) from error

    @cached_property
    def calibrations(self) -> Sequence[Calibration]:
        """All calibrations of the chosen layer, sorted by camera, stage and validity."""
        names = CALIBRATIONS.schema.names
        arrays = self._table("calibrations", self._layers.calibrations, CALIBRATIONS.name, names)
        rows = pa.Table.from_arrays(list(arrays), names=names).to_pylist()
        return [
            Calibration(
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

    def calibration(self, camera: str, timestamp_ns: int) -> Calibration:
        """The calibration that holds for a camera at an instant.

        Raises:
            DatasetError: there is none.
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
        there = sorted({item.stage for item in self.calibrations if item.camera == camera})
        raise DatasetError(
            f"no calibration of camera {camera} holds at {timestamp_ns}",
            file=f"traversals/{self.traversal_id}",
            place=f"calibrations of layer {self._layers.calibrations}",
            expected=f"stage {self._layers.stage}" if self._layers.stage else "a row valid at that time",
            remedy=f"choose a stage that is there: {', '.join(there)}" if there else "calibrate the camera",
        )

    def pictures(self, frame_index: int) -> Sequence[Mapping[str, Any]]:
        """Rows of the pictures of one frame."""
        group = self._group("images")
        if group is None:
            return []
        (index,) = self._catalog.columns.read(*group, ["frame_index"])
        rows = np.flatnonzero(floats_or_nan(index) == frame_index)
        arrays = self._catalog.columns.read(*group, _PICTURE)
        return [{name: array[row].as_py() for name, array in zip(_PICTURE, arrays)} for row in rows.tolist()]

    def masks(self, camera: str, timestamp_ns: int) -> Sequence[Mapping[str, Any]]:
        """Rows of the masks of one picture."""
        group = self._group("masks")
        if group is None:
            return []
        names = MASKS.schema.names
        arrays = dict(zip(names, self._catalog.columns.read(*group, names)))
        hit = (to_numpy(arrays["timestamp_ns"]) == timestamp_ns) & is_member(arrays["camera"], frozenset([camera]))
        return [{name: arrays[name][row].as_py() for name in names} for row in np.flatnonzero(hit).tolist()]

    def depth(self, camera: str, timestamp_ns: int) -> Mapping[str, Any] | None:
        """Row of the depth map of one picture, of the chosen layer; None: it has none.

        Raises:
            UsageError: the traversal has several layers of depth maps and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        found = self._depth.get((camera, timestamp_ns))
        if found is None:
            return None
        rows, row = found
        return {name: array[row].as_py() for name, array in rows.items()}

    @cached_property
    def _depth(self) -> Mapping[tuple[str, int], tuple[Mapping[str, pa.Array], int]]:
        names = DEPTH.schema.names
        self._require_listed("depth", self._layers.depth)
        group = self._group("depth")
        if group is None:
            return {}
        arrays = dict(zip(names, self._catalog.columns.read(*group, names)))
        own = np.flatnonzero(self._of_layer("depth", arrays, self._layers.depth)).tolist()
        cameras, stamps = arrays["camera"].to_pylist(), arrays["timestamp_ns"].to_pylist()
        return {(cameras[row], stamps[row]): (arrays, row) for row in own}

    def _of_layer(self, kind: str, arrays: Mapping[str, pa.Array], chosen: str | None) -> Bool:
        """Which rows (N,) of a layer table are of the chosen layer."""
        return rows_of_layer(kind, self.traversal_id, arrays["source"], arrays["source_version"], chosen)

    def boxes(self, timestamp_ns: int) -> FrameBoxes:
        """The boxes nearest in time, in the ego frame of their own instant.

        Boxes count as those of an instant if they are at most half a period of their layer away; of a layer with one
        instant only those of that very instant do.

        Raises:
            UsageError: the traversal has several box layers and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        stamps, table = self._boxes
        instants = np.unique(stamps)
        if len(instants):
            nearest = instants[np.argmin(np.abs(instants - timestamp_ns))]
            period = float(np.median(np.diff(instants))) if len(instants) > 1 else 0.0
            if 2 * abs(int(nearest) - timestamp_ns) <= period:
                return _frame_boxes(table, np.flatnonzero(stamps == nearest), int(nearest))
        return _frame_boxes(table, np.empty(0, np.int64), timestamp_ns)

    @cached_property
    def track_ids(self) -> tuple[str, ...]:
        """Every object that the boxes of the chosen layer have, sorted.

        Raises:
            UsageError: the traversal has several box layers and none was chosen.
            DatasetError: the traversal does not have the chosen layer.
        """
        _, table = self._boxes
        return tuple(sorted(set(table["track_id"].to_pylist()))) if table else ()

    @cached_property
    def _boxes(self) -> tuple[Int64, Mapping[str, pa.Array]]:
        names = BOXES.schema.names
        self._require_listed("boxes", self._layers.boxes)
        group = self._group("boxes")
        if group is None:
            return np.empty(0, np.int64), {}
        arrays = dict(zip(names, self._catalog.columns.read(*group, names)))
        own = self._of_layer("boxes", arrays, self._layers.boxes)
        return to_numpy(arrays["timestamp_ns"])[own], {
            name: array.filter(to_arrow_mask(own)) for name, array in arrays.items()
        }

    def _group(self, name: str) -> tuple[str, int] | None:
        """File and position of this traversal's row group of an index table; None: it has no rows."""
        return self._catalog.group_of(name, self.row)

    def _table(self, kind: str, layer: str, name: str, columns: Sequence[str]) -> list[pa.Array]:
        """Columns of a recorded table, or of the same table in a layer."""
        if layer == "recorded":
            group = self._group(name)
            return self._catalog.columns.read(*group, columns) if group else [pa.nulls(0) for _ in columns]
        self._require_listed(kind, layer)
        path = f"traversals/{self.traversal_id}/layers/{kind}/{layer}/{name}.parquet"
        return self._catalog.columns.read(path, 0, columns)

    def _require_listed(self, kind: str, layer: str | None) -> None:
        """See that this traversal has a layer, if one is chosen; there may be no rows of it."""
        if layer is None:
            return
        own = self._catalog.read_global("traversals", ["layers"]).column(0)[self.row].as_py()
        if f"{kind}/{layer}" not in own:
            raise no_layer(kind, layer, f"traversals/{self.traversal_id}/layers/{kind}")


def rows_of_layer(kind: str, traversal_id: str, source: pa.Array, version: pa.Array, chosen: str | None) -> Bool:
    """Which rows (N,) of a traversal are of one of its layers.

    Args:
        kind: of the layers, for the messages.
        traversal_id: the traversal.
        source: (N,) who made each row; at least one.
        version: (N,) version of the source.
        chosen: ``source@version``, which may have no rows; None: the only one there is.

    Raises:
        UsageError: there are several and none was chosen.
    """
    names = layer_names(source, version)
    there = sorted(pc.unique(names).to_pylist())
    if chosen is None:
        if len(there) > 1:
            raise UsageError(
                f"traversal {traversal_id} has {kind} of {', '.join(there)}",
                remedy=f"choose: with_layers({kind}={there[-1]!r})",
            )
        chosen = there[0]
    return is_member(names, frozenset([chosen]))


def layer_names(source: pa.Array, version: pa.Array) -> pa.Array:
    """``source@version`` (N,) of rows with a source (N,) and its version (N,)."""
    return pc.binary_join_element_wise(source.cast(pa.string()), version.cast(pa.string()), "@")


def no_layer(kind: str, layer: str, where: str) -> DatasetError:
    """The error for a layer that is not there."""
    return DatasetError(
        f"there is no {kind} layer {layer}",
        file=where,
        expected="a complete layer of that name",
        remedy="choose another with with_layers(...), or leave this traversal out with where(...)",
    )


def _frame_boxes(table: Mapping[str, pa.Array], rows: Int64, timestamp_ns: int) -> FrameBoxes:
    def floats(*names: str) -> Float64:
        if not len(rows):
            return np.empty((0, len(names)))
        return np.stack([floats_or_nan(table[name])[rows] for name in names], axis=1)

    def words(name: str) -> tuple[str, ...]:
        return tuple(table[name][row].as_py() for row in rows.tolist())

    return FrameBoxes(
        frame="ego",
        timestamp_ns=timestamp_ns,
        pose=Poses(floats(*_POSE[:4]), floats(*_POSE[4:])),
        size_m=floats("length_m", "width_m", "height_m"),
        velocity_mps=floats("vx_mps", "vy_mps", "vz_mps"),
        category=words("category"),
        track_id=words("track_id"),
        score=floats("score")[:, 0],
        source=tuple(f"{source}@{version}" for source, version in zip(words("source"), words("source_version"))),
    )
