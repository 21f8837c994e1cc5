"""One scene for the rules: the recorded tables and layers of its traversals. They are read on first use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from mirror.arrays import Bool, Int64
from mirror.dataset.taken_down import drop_images
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera, camera_from_row
from mirror.integrity.dataset_view import DatasetView, TraversalView
from mirror.integrity.frames import FrameAssignment, assign_frames
from mirror.integrity.images import ImageContents, ImageFileReader, ImageFiles
from mirror.integrity.motion import MotionColumns
from mirror.integrity.rows import TablePart, TableRows
from mirror.schema.documents import Roi
from mirror.schema.road_map import RoadMap
from mirror.schema.tables import (
    BOXES,
    CALIBRATIONS,
    DEPTH,
    EGO_POSES,
    IMAGES,
    LAYER_TABLES,
    LIDARS,
    MASKS,
    POINTS,
    Table,
)


class SceneView:
    """The tables of one scene.

    Args:
        dataset: the dataset.
        scene: the scene.

    Attributes:
        traversals: its traversals, in order of id; rows name them by their number here.
    """

    def __init__(self, dataset: DatasetView, scene: Roi) -> None:
        self.dataset = dataset
        self.scene = scene
        self.traversals: Sequence[TraversalView] = [
            item for item in dataset.traversals.values() if item.scene.scene_id == scene.scene_id
        ]

    @property
    def road_map(self) -> RoadMap | None:
        """The recorded road map; None if it is missing or broken."""
        return self.dataset.road_maps.get(self.scene.scene_id)

    @cached_property
    def poses(self) -> TableRows:
        """Recorded poses."""
        return self._recorded(EGO_POSES)

    @cached_property
    def images(self) -> TableRows:
        """Recorded images."""
        return self._recorded(IMAGES)

    @cached_property
    def calibrations(self) -> TableRows:
        """Recorded calibrations."""
        return self._recorded(CALIBRATIONS)

    @cached_property
    def all_poses(self) -> TableRows:
        """Recorded poses and poses of layers."""
        return self._with_layers(self.poses, "poses")

    @cached_property
    def all_images(self) -> TableRows:
        """Recorded and redacted images, without those that were taken down: their bytes may be gone."""
        return self.without_taken_down(self._with_layers(self.images, "redaction"))

    @cached_property
    def all_calibrations(self) -> TableRows:
        """Recorded calibrations and calibrations of layers."""
        return self._with_layers(self.calibrations, "calibrations")

    @cached_property
    def boxes(self) -> TableRows:
        """Boxes of all layers."""
        return TableRows(BOXES, self._layers("boxes"))

    @cached_property
    def masks(self) -> TableRows:
        """Masks of all layers."""
        return TableRows(MASKS, self._layers("masks"))

    @cached_property
    def depth(self) -> TableRows:
        """Depth maps of all layers."""
        return TableRows(DEPTH, self._layers("depth"))

    @cached_property
    def points(self) -> TableRows:
        """Points of all layers."""
        return TableRows(POINTS, self._layers("points"))

    @cached_property
    def lidars(self) -> TableRows:
        """Lidar sweeps, whose files lie outside of the dataset."""
        return TableRows(LIDARS, self._layers("lidars"))

    @cached_property
    def motion(self) -> MotionColumns:
        """The vehicle's motion over `all_poses`."""
        return MotionColumns(self.all_poses)

    @cached_property
    def has_motion(self) -> Bool:
        """(T,) False for traversals whose recording declares that its stamps only number the poses."""
        return np.array([item.drive.has_motion for item in self.traversals], np.bool_)

    @cached_property
    def frames(self) -> FrameAssignment:
        """The frames that `images` make up."""
        return assign_frames(
            self.images, [None if item.rig is None else item.rig.reference_camera for item in self.traversals]
        )

    @cached_property
    def cameras(self) -> Mapping[int, Camera]:
        """Cameras by row of `all_calibrations`, for valid rows."""
        return self._made_cameras[0]

    @cached_property
    def camera_errors(self) -> Mapping[int, UsageError]:
        """Errors by row of `all_calibrations`, for rows without a valid camera."""
        return self._made_cameras[1]

    @cached_property
    def _made_cameras(self) -> tuple[dict[int, Camera], dict[int, UsageError]]:
        made: dict[int, Camera] = {}
        errors: dict[int, UsageError] = {}
        for number, row in enumerate(self.all_calibrations.data.to_pylist()):
            try:
                # Most traversals have equal cameras: one object serves for all, with its cached values.
                camera = camera_from_row(row)
                made[number] = self.dataset.cameras.setdefault(camera, camera)
            except UsageError as error:
                errors[number] = error
        return made, errors

    @cached_property
    def etags(self) -> Mapping[str, str]:
        """ETags of images outside of the dataset, by uri, as they were when they were ingested."""
        return {uri: etag for item in self.traversals for uri, etag in self.dataset.etags(item.traversal_id).items()}

    @property
    def _image_reader(self) -> ImageFileReader:
        return ImageFileReader(self.all_images, self.dataset.image_store, self.dataset.sizes)

    @cached_property
    def image_files(self) -> ImageFiles:
        """Sizes and end markers of the files of `all_images`."""
        return self._image_reader.files()

    @cached_property
    def image_contents(self) -> ImageContents:
        """Contents of the files that `all_images` lists."""
        return self._image_reader.contents(self.image_files)

    def calibrated_images(self) -> Iterator[tuple[int, slice, Bool]]:
        """Yield each row of `calibrations`, its traversal's rows of `images`, and a mask of its camera's rows."""
        taken, names = self.images.text_codes("camera")
        code_of = {name: code for code, name in enumerate(names)}
        cameras, camera_names = self.calibrations.text_codes("camera")
        images = {number: rows for _, number, rows in self.images.slices()}
        for _, number, rows in self.calibrations.slices():
            own = images.get(number, slice(0, 0))
            for row in range(rows.start, rows.stop):
                yield row, own, taken[own] == code_of.get(camera_names[cameras[row]], -1)

    def pose_span(self) -> tuple[Int64, Int64]:
        """Return the first and the last stamp (traversals,) of the recorded poses.

        Where there are none, the first is the larger.
        """
        stamps = self.poses.integers("timestamp_ns")
        first = np.full(len(self.traversals), np.iinfo(np.int64).max)
        last = np.full(len(self.traversals), np.iinfo(np.int64).min)
        np.minimum.at(first, self.poses.traversal, stamps)
        np.maximum.at(last, self.poses.traversal, stamps)
        return first, last

    def has_valid_poses(self, rows: slice) -> bool:
        """Return whether recorded poses can be interpolated: some exist, forward in time, finite, of unit length."""
        motion = self.motion
        return (
            rows.stop > rows.start
            and bool((motion.step_s[rows][1:] > 0).all() and motion.unit[rows].all())
            and bool(np.isfinite(motion.position[rows]).all())
        )

    def tables(self) -> Sequence[TableRows]:
        """Return every table, layers included."""
        recorded = (self.all_poses, self.all_images, self.all_calibrations)
        return (*recorded, self.boxes, self.masks, self.depth, self.points, self.lidars)

    @cached_property
    def entry_ns(self) -> Int64:
        """(T,) times of the traversals' entries; the smallest int64 where the ledger has none."""
        return self._passed("entry_ns", np.iinfo(np.int64).min)

    @cached_property
    def exit_ns(self) -> Int64:
        """(T,) times of the traversals' exits; the largest int64 where the ledger has none."""
        return self._passed("exit_ns", np.iinfo(np.int64).max)

    def without_taken_down(self, rows: TableRows) -> TableRows:
        """Return the rows of a table of images, masks or depth maps without those of images that were taken down."""
        gone = [self.dataset.taken_down.get(item.traversal_id, frozenset()) for item in self.traversals]
        if not any(gone):
            return rows
        parts = [(file, number, drop_images(data, gone[number])) for file, number, data in rows.parts]
        return TableRows(rows.table, parts)

    def _passed(self, name: str, default: int) -> Int64:
        values = [default if item.ledger_row is None else item.ledger_row[name] for item in self.traversals]
        return np.array(values, np.int64)

    def _recorded(self, table: Table) -> TableRows:
        folders = [(n, self.dataset.layout.recorded(item.traversal_id)) for n, item in enumerate(self.traversals)]
        return TableRows(table, self.dataset.parts(table, folders))

    def _layers(self, kind: str) -> list[TablePart]:
        folders = [
            (number, self.dataset.layout.layer(item.traversal_id, kind, source, version))
            for number, item in enumerate(self.traversals)
            for layer_kind, source, version in item.layers
            if layer_kind == kind
        ]
        return self.dataset.parts(LIDARS if kind == LIDARS.name else LAYER_TABLES[kind], folders)

    def _with_layers(self, recorded: TableRows, kind: str) -> TableRows:
        layers = self._layers(kind)
        return TableRows(recorded.table, [*recorded.parts, *layers]) if layers else recorded
