"""The JSON tables of a nuScenes folder as columns, read when they are needed and shared by all its scenes.

A folder has hundreds of scenes in one set of tables. The large tables are read once, reduced to the columns that MIRROR
uses, and sorted by scene: a scene is then a slice of them.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.opening import find_file, read_json, unreadable_error
from mirror.recordings.readers.json_tables import matrix_of, read_columns
from mirror.recordings.readers.nuscenes_rows import (
    ANNOTATION,
    EGO_POSE,
    INSTANCE,
    SAMPLE,
    SAMPLE_DATA,
    Annotations,
    EgoPoses,
    Index,
    Sensor,
    SensorData,
)

TABLES: Final = (
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "map",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
)
REMEDY: Final = "download the metadata archive of this version again: it holds all 13 tables"
_FOLDERS_HELD: Final = 2


@dataclass(frozen=True)
class Tables:
    """The tables of one version folder; every method names the file at fault in its errors.

    Attributes:
        root: the folder with ``samples``, ``sweeps`` and the version folders.
        folder: the version folder, which holds the tables.
    """

    root: Path
    folder: Path
    _lock: threading.RLock = field(default_factory=threading.RLock, repr=False, compare=False)

    def file(self, table: str) -> Path:
        """Return the file of a table.

        Raises:
            RecordingError: it is missing, or is a link that leads outside.
        """
        name = (self.folder.relative_to(self.root) / f"{table}.json").as_posix()
        path = find_file(self.root, name)
        if path is None:
            raise RecordingError(
                "missing", file=self.folder / f"{table}.json", expected="one of the 13 tables", remedy=REMEDY
            )
        return path

    def records(self, table: str) -> dict[str, Mapping[str, Any]]:
        """Return the objects of a small table by token.

        Raises:
            RecordingError: the file is missing or broken, or an object has no token.
        """
        file = self.file(table)
        rows = read_json(file)
        if not isinstance(rows, list):
            raise RecordingError("not a list of objects", file=file, expected="one JSON list", remedy=REMEDY)
        records: dict[str, Mapping[str, Any]] = {}
        for number, row in enumerate(rows):
            token = row.get("token") if isinstance(row, dict) else None
            if not isinstance(token, str) or not token:
                raise RecordingError(
                    "an object without a token", file=file, place=f"object {number}", expected="a text", remedy=REMEDY
                )
            records[token] = row
        return records

    def text(self, table: str, record: Mapping[str, Any], key: str) -> str:
        """Return a text of an object of a small table.

        Raises:
            RecordingError: the object has no such text.
        """
        value = record.get(key)
        if not isinstance(value, str):
            raise RecordingError(
                f"no text {key!r}",
                file=self.folder / f"{table}.json",
                place=f"token {record['token']}",
                expected="an object of nuScenes v1.0",
                remedy=REMEDY,
            )
        return value

    def follow(
        self, table: str, record: Mapping[str, Any], key: str, target: Mapping[str, Mapping[str, Any]], of: str
    ) -> Mapping[str, Any]:
        """Return the object to which a token of another object refers.

        Raises:
            RecordingError: there is no such object.
        """
        token = self.text(table, record, key)
        if token not in target:
            raise self.dangling_error(table, f"token {record['token']}", key, token, of)
        return target[token]

    def dangling_error(self, table: str, place: str, key: str, token: str, of: str) -> RecordingError:
        """Return the error for a token that names no object."""
        return RecordingError(
            f"{key} {token!r:.60} names no object of {of}.json",
            file=self.folder / f"{table}.json",
            place=place,
            expected="a token of that table",
            remedy=REMEDY + "; tables of different versions do not fit together",
        )

    @cached_property
    def scenes(self) -> dict[str, Mapping[str, Any]]:
        """The objects of ``scene`` by name."""
        by_name: dict[str, Mapping[str, Any]] = {}
        for record in self.records("scene").values():
            name = self.text("scene", record, "name")
            if name in by_name:
                raise RecordingError(
                    f"two scenes are named {name!r:.60}", file=self.folder / "scene.json", expected="unique names"
                )
            by_name[name] = record
        return by_name

    @cached_property
    def sensors(self) -> list[Sensor]:
        """The calibrated sensors of all logs."""
        sensors, calibrated = self.records("sensor"), []
        for record in self.records("calibrated_sensor").values():
            sensor = self.follow("calibrated_sensor", record, "sensor_token", sensors, "sensor")
            channel, modality = (self.text("sensor", sensor, key) for key in ("channel", "modality"))
            calibrated.append(Sensor(str(record["token"]), channel, modality, record))
        return calibrated

    def scene_number(self, scene: Mapping[str, Any]) -> int:
        """Return the position of a scene among all scenes."""
        return self._scene_numbers[str(scene["token"])]

    @cached_property
    def _scene_numbers(self) -> dict[str, int]:
        return {str(record["token"]): number for number, record in enumerate(self.scenes.values())}

    @cached_property
    def _samples(self) -> pa.Table:
        """Token, stamp and number of the scene of every sample."""
        table = read_columns(self.file("sample"), SAMPLE)
        scene = self._find(table, "scene_token", pa.array(list(self._scene_numbers)), "sample", "scene")
        return table.drop_columns(["scene_token"]).append_column("scene", pa.array(scene))

    def _find(self, table: pa.Table, key: str, tokens: pa.Array, of: str, target: str) -> Index:
        """(N,) position among tokens of each row's token.

        Raises:
            RecordingError: a token is not among them.
        """
        found = find_tokens(table.column(key), tokens)
        if (found < 0).any():
            row = int(np.argmax(found < 0))
            raise self.dangling_error(of, f"object {row}", key, table.column(key)[row].as_py(), target)
        return found

    @cached_property
    def _data(self) -> tuple[SensorData, EgoPoses, Int64]:
        """All sensor data and poses, and the first row of each scene."""
        with self._lock:
            table = read_columns(self.file("sample_data"), SAMPLE_DATA)
            samples = self._samples
            sample = self._find(
                table, "sample_token", samples.column("token").combine_chunks(), "sample_data", "sample"
            )
            scene = np.asarray(samples.column("scene"))[sample]
            tokens = pa.array([sensor.token for sensor in self.sensors], pa.string())
            sensor = find_tokens(table.column("calibrated_sensor_token"), tokens)
            # Tokens that are followed are not needed any more; the next table is as large.
            table = table.drop_columns(["sample_token", "calibrated_sensor_token"])
            poses = read_columns(self.file("ego_pose"), EGO_POSE)
            pose = find_tokens(table.column("ego_pose_token"), poses.column("token").combine_chunks())
            stamps = np.asarray(table.column("timestamp"))
            order = np.lexsort((stamps, sensor, scene))
            size = [np.asarray(pc.fill_null(table.column(name), 0.0)) for name in ("width", "height")]
            data = SensorData(
                stamps,
                sensor,
                pose,
                np.asarray(table.column("is_key_frame")),
                np.clip(np.nan_to_num(np.stack(size, axis=1)), 0, 2**31 - 1).astype(np.int32),
                table.column("filename").combine_chunks(),
            ).take(order)
            ego = EgoPoses(
                np.asarray(poses.column("timestamp")),
                matrix_of(poses.column("rotation")),
                matrix_of(poses.column("translation")),
            )
            starts = np.searchsorted(scene[order], np.arange(len(self.scenes) + 1))
            del table, poses
            pa.default_memory_pool().release_unused()
            return data, ego, starts

    @property
    def poses(self) -> EgoPoses:
        """All ego poses."""
        with self._lock:
            return self._data[1]

    def data_of(self, scene: Mapping[str, Any]) -> SensorData:
        """Return the sensor data of a scene, sorted by sensor and time.

        Raises:
            RecordingError: the scene has none, or a row names a sensor or a pose that does not exist.
        """
        with self._lock:
            data, _, starts = self._data
        number = self.scene_number(scene)
        rows = data.take(slice(int(starts[number]), int(starts[number + 1])))
        place = f"scene {scene['name']}"
        if not len(rows.timestamp_us):
            raise RecordingError(
                "the scene has no data", file=self.folder / "sample_data.json", place=place, remedy=REMEDY
            )
        for key, found, of in (
            ("calibrated_sensor_token", rows.sensor, "calibrated_sensor"),
            ("ego_pose_token", rows.pose, "ego_pose"),
        ):
            if (found < 0).any():
                name = rows.filename[int(np.argmax(found < 0))].as_py()
                raise self.dangling_error("sample_data", f"{place}, {name}", key, "", of)
        return rows

    @cached_property
    def instances(self) -> tuple[list[str], list[str]]:
        """Tokens of all instances, and their categories.

        Raises:
            RecordingError: a category does not exist.
        """
        table = read_columns(self.file("instance"), INSTANCE)
        categories = self.records("category")
        number = self._find(table, "category_token", pa.array(list(categories), pa.string()), "instance", "category")
        names = [self.text("category", record, "name") for record in categories.values()]
        return table.column("token").to_pylist(), [names[index] for index in number.tolist()]

    @cached_property
    def _annotations(self) -> tuple[Annotations, Int64]:
        with self._lock:
            table = read_columns(self.file("sample_annotation"), ANNOTATION)
            samples = self._samples
            sample = self._find(
                table, "sample_token", samples.column("token").combine_chunks(), "sample_annotation", "sample"
            )
            scene, stamps = (np.asarray(samples.column(name))[sample] for name in ("scene", "timestamp"))
            instance = find_tokens(table.column("instance_token"), pa.array(self.instances[0], pa.string()))
            order = np.lexsort((stamps, instance, scene))
            numbers = [matrix_of(table.column(name))[order] for name in ("rotation", "translation", "size")]
            attributes = self._attributes(table).take(pa.array(order))
            rows = Annotations(stamps[order], instance[order], numbers[0], numbers[1], numbers[2], attributes)
            return rows, np.searchsorted(scene[order], np.arange(len(self.scenes) + 1))

    def _attributes(self, table: pa.Table) -> pa.Array:
        """The names of the attributes of each annotation, as lists.

        Raises:
            RecordingError: an annotation names an attribute that does not exist.
        """
        lists = table.column("attribute_tokens").combine_chunks()
        records = self.records("attribute")
        tokens, owner = lists.flatten(), np.asarray(pc.list_parent_indices(lists))
        found = find_tokens(tokens, pa.array(list(records), pa.string()))
        if (found < 0).any():
            place = int(np.argmax(found < 0))
            token = tokens[place].as_py()
            raise self.dangling_error(
                "sample_annotation", f"object {owner[place]}", "attribute_tokens", str(token), "attribute"
            )
        names = pa.array([self.text("attribute", record, "name") for record in records.values()], pa.string())
        ends = np.searchsorted(owner, np.arange(len(lists) + 1))
        return pa.ListArray.from_arrays(pa.array(ends, pa.int32()), names.take(pa.array(found)))

    def annotations_of(self, scene: Mapping[str, Any]) -> Annotations:
        """Return the annotations of a scene, sorted by instance and time.

        Raises:
            RecordingError: an annotation names an instance that does not exist.
        """
        with self._lock:
            annotations, starts = self._annotations
        number = self.scene_number(scene)
        rows = annotations.take(slice(int(starts[number]), int(starts[number + 1])))
        if (rows.instance < 0).any():
            place = f"scene {scene['name']}"
            raise self.dangling_error("sample_annotation", place, "instance_token", "", "instance")
        return rows


def find_tokens(column: pa.ChunkedArray, tokens: pa.Array) -> Index:
    """Return the position (N,) of each token in a list of tokens; -1 for an unknown token."""
    return np.asarray(pc.fill_null(pc.index_in(column, value_set=tokens), -1), np.int32)


_HELD: dict[Path, tuple[tuple[object, ...], Tables]] = {}
_HELD_LOCK: Final = threading.Lock()


def open_tables(root: Path, folder: Path) -> Tables:
    """Open the tables of a version folder; drives that are opened one after the other share the tables.

    Args:
        root: the folder with the files of the sensors.
        folder: the version folder.

    Raises:
        RecordingError: a table is missing.
    """
    tables = Tables(root, folder)
    state = []
    for table in TABLES:
        file = tables.file(table)
        try:
            status = file.stat()
        except OSError as error:
            raise unreadable_error(file, error) from error
        state.append((status.st_size, status.st_mtime_ns, status.st_ino))
    key = folder.resolve()
    with _HELD_LOCK:
        held = _HELD.pop(key, None)
        if held is None or held[0] != tuple(state) or held[1].root != root:
            held = (tuple(state), tables)
        _HELD[key] = held
        while len(_HELD) > _FOLDERS_HELD:
            _HELD.pop(next(iter(_HELD)))
        return held[1]
