"""nuScenes: scenes of 20 s in one folder, with six cameras, 13 JSON tables and annotated frames at 2 Hz.

Facts of the format, from the schema that the dataset publishes and from its devkit 1.2.0:

- Stamps are Unix microseconds. The stamp of an image is the trigger of its exposure; exposure lengths are not recorded.
- Ego poses are ``map_SE3_ego``: the map is metric, x east, y north; the ego is x forward, y left, z up, with its origin
  on the ground under the rear axle. Version 1.0 has only poses in the plane: z is 0 throughout.
- Cameras are rectified pinholes; their frame is x right, y down, z forward. The devkit's principal points have the
  centre of the first pixel at 0.
- Boxes are ``map_SE3_box`` with sizes in the order width, length, height.
- A map's origin is its south-western corner. The devkit converts to degrees on a sphere of 6,378,137 m, on which a
  metre is up to 0.7 % off. Here the map is the east-north-up tangent plane of WGS 84 at that corner: metres remain.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.geometry.geodesy import TangentFrame
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import track_from_tangent
from mirror.recordings.lidars import LidarSweeps
from mirror.recordings.opening import find_file
from mirror.recordings.paths import require_files_inside, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, FileStream, ImageStream, RigInfo, Track
from mirror.recordings.raster import codec_of_name
from mirror.recordings.readers.collection import choose_drive, one_of
from mirror.recordings.readers.json_tables import entry_errors
from mirror.recordings.readers.nuscenes_boxes import make_boxes
from mirror.recordings.readers.nuscenes_lidars import read_sweeps
from mirror.recordings.readers.nuscenes_relatives import FOLDERS_OF_RELATIVES, refuse_relatives
from mirror.recordings.readers.nuscenes_rows import SensorData
from mirror.recordings.readers.nuscenes_tables import REMEDY, TABLES, Tables, open_tables
from mirror.recordings.readers.stored_poses import mark_rotations
from mirror.recordings.registry import refuse_options
from mirror.recordings.weather import WEATHER

_VERSION: Final = re.compile(r"v\d+\.\d+(-\w+)?")
_KNOWN_VERSION: Final = "v1."
# Longitude and latitude of the south-western corner of each map, as the devkit has them.
_ORIGINS: Final = {
    "boston-seaport": (-71.05785369873047, 42.336849169438615),
    "singapore-onenorth": (103.78475189208984, 1.2882100868743724),
    "singapore-hollandvillage": (103.78217697143555, 1.2993652317780957),
    "singapore-queenstown": (103.76741409301758, 1.2782562240223188),
}
_CANONICAL: Final = {
    "CAM_FRONT": "front_wide",
    "CAM_FRONT_NARROW": "front_narrow",
    "CAM_FRONT_LEFT": "front_left",
    "CAM_FRONT_RIGHT": "front_right",
    "CAM_BACK_LEFT": "rear_left",
    "CAM_BACK_RIGHT": "rear_right",
    "CAM_BACK": "rear",
}
_SIX: Final = {"front_wide", "front_left", "front_right", "rear_left", "rear_right", "rear"}
_OPTIONS: Final = ("sweeps",)


class NuscenesReader:
    """A reader of the scenes of a nuScenes folder; each scene is a drive with the path ``FOLDER/SCENE``."""

    name = "nuscenes"
    expects = "a nuScenes folder with v1.0-mini, v1.0-trainval or v1.0-test, or FOLDER/SCENE"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder is a version folder with tables, or holds one."""
        return bool(_version_folders(path))

    def drives(self, path: Path) -> Sequence[str]:
        """Return the names of the scenes.

        With several versions, they are ``VERSION/SCENE`` of the largest version that has the scene.
        """
        folders = _version_folders(path)
        root = _root(path)
        for folder in folders:
            refuse_relatives(root, folder)
        found = {folder: list(open_tables(root, folder).scenes) for folder in folders}
        names: dict[str, str] = {}
        for folder in sorted(folders, key=lambda folder: (-len(found[folder]), folder.name)):
            prefix = f"{folder.name}/" if len(folders) > 1 else ""
            for name in found[folder]:
                names.setdefault(name, prefix + to_identifier(name))
        return sorted(names.values())

    def open(self, path: Path, options: Mapping[str, str]) -> NuscenesRecording:
        """Open a scene.

        The option ``sweeps`` is ``yes`` (all images, the default) or ``no`` (images of annotated frames only).
        """
        refuse_options(options, _OPTIONS, path, self.name)
        sweeps = one_of(options, "sweeps", ("yes", "no"), path)
        folders, scene = _version_folders(path), None
        place = path
        if not folders:
            place, scene = path.parent, path.name
            folders = _version_folders(place)
        if not folders:
            raise RecordingError("no tables of nuScenes", file=path, expected=self.expects, remedy=REMEDY)
        for folder in folders:
            refuse_relatives(_root(place), folder)
            if not folder.resolve().name.startswith(_KNOWN_VERSION):
                raise RecordingError(
                    f"version {folder.name} is not supported",
                    file=folder,
                    expected="v1.0-mini, v1.0-trainval or v1.0-test",
                    remedy="update MIRROR if this is a newer version of nuScenes",
                )
        if len(folders) > 1:
            names = self.drives(place)
            chosen = choose_drive(names, scene, place)
            raise RecordingError(
                f"{len(folders)} versions of the tables in one folder",
                file=place,
                expected="the version in the path",
                remedy=f"name it: {place / chosen}",
            )
        tables = open_tables(_root(place), folders[0])
        by_name = {to_identifier(name): record for name, record in tables.scenes.items()}
        return NuscenesRecording(tables, by_name[choose_drive(list(by_name), scene, place)], sweeps=sweeps == "yes")


def _version_folders(path: Path) -> list[Path]:
    """The version folders in a folder, or the folder itself if it is one."""
    if not path.is_dir():
        return []
    if _has_tables(path, path):
        return [path]
    children = [
        child
        for child in path.iterdir()
        if (_VERSION.fullmatch(child.name) or child.name in FOLDERS_OF_RELATIVES) and child.is_dir()
    ]
    return sorted(child for child in children if _has_tables(path, child))


def _has_tables(root: Path, folder: Path) -> bool:
    """Return whether a folder has at least three of the tables; a missing one is an error of the scenes."""
    prefix = "" if folder == root else folder.name + "/"
    return sum(find_file(root, f"{prefix}{table}.json") is not None for table in TABLES) >= 3


def _root(path: Path) -> Path:
    """The folder of the sensors' files: that above a version folder."""
    return path.parent if _has_tables(path, path) else path


@dataclass(frozen=True)
class NuscenesRecording:
    """One scene of nuScenes.

    Attributes:
        tables: the folder's tables.
        scene: the object of the table ``scene``.
        sweeps: whether images between annotated frames are read.
    """

    tables: Tables
    scene: Mapping[str, Any]
    sweeps: bool = True

    @cached_property
    def _log(self) -> Mapping[str, Any]:
        return self.tables.follow("scene", self.scene, "log_token", self.tables.records("log"), "log")

    @cached_property
    def _location(self) -> str:
        return self.tables.text("log", self._log, "location")

    @cached_property
    def _frame(self) -> TangentFrame | None:
        """The map's frame on WGS 84; None: the location is not one of nuScenes."""
        if "origin_wgs84" in self._log:
            with entry_errors(self.tables.file("log"), "origin_wgs84", "longitude, latitude and height"):
                longitude, latitude, height = (float(value) for value in self._log["origin_wgs84"])
                if not (abs(longitude) <= 180.0 and abs(latitude) <= 90.0 and abs(height) < 1e5):
                    raise ValueError("not a place on the globe")
            return TangentFrame(longitude, latitude, height)
        origin = _ORIGINS.get(self._location)
        return None if origin is None else TangentFrame(*origin)

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; its id is the scene's name; light and weather come from the words of its description."""
        description = self.scene.get("description")
        light, weather = parse_description(description if isinstance(description, str) else "")
        place = self._location.partition("-")[0]
        return DriveInfo(
            drive_id=to_identifier(self.tables.text("scene", self.scene, "name")),
            vehicle_id=to_identifier(self.tables.text("log", self._log, "vehicle")),
            vehicle_type="unknown",
            time_base="Unix microseconds",
            frame=None if self._frame is not None else to_identifier(self._location),
            is_clip=True,
            city=place.capitalize() or None,
            weather=weather,
            light=light,
            licence="CC BY-NC-SA 4.0" if self._location in _ORIGINS else None,
        )

    @cached_property
    def _data(self) -> SensorData:
        return self.tables.data_of(self.scene)

    @cached_property
    def _cameras(self) -> dict[str, SensorData]:
        """Rows of the images by channel, in order of time; the front camera first."""
        data, sensors = self._data, self.tables.sensors
        channels = {index: sensors[index].channel for index in np.unique(data.sensor).tolist()}
        cameras = sorted({channels[index] for index in channels if sensors[index].modality == "camera"})
        rows = {}
        for channel in sorted(cameras, key=lambda name: (name != "CAM_FRONT", name)):
            mine = np.isin(data.sensor, [index for index, name in channels.items() if name == channel])
            of_camera = data.take(mine if self.sweeps else mine & data.key_frame)
            if len(of_camera.timestamp_us):
                rows[channel] = of_camera.take(np.argsort(of_camera.timestamp_us, kind="stable"))
        return rows

    @cached_property
    def rig(self) -> RigInfo | None:
        """The cameras under canonical names; the front camera is the reference camera."""
        names = {channel: _CANONICAL.get(channel, to_identifier(channel)) for channel in self._cameras}
        if not names:
            return None
        cameras = tuple(CameraInfo(name, channel) for channel, name in names.items())
        digest = sha256(" ".join(sorted(names)).encode()).hexdigest()[:8]
        rig_id = "nuscenes" if set(names.values()) == _SIX else f"nuscenes_{digest}"
        return RigInfo(rig_id, cameras, cameras[0].name)

    def named_files(self) -> Sequence[tuple[str, Path]]:
        """Return the tables and the scene's images, missing ones included; no point cloud or map is opened."""
        files = {name: self.tables.folder / name for name in (f"{table}.json" for table in TABLES)}
        for channel, rows in self._cameras.items():
            files |= dict(zip(rows.filename.to_pylist(), self._image_paths[channel]))
        return sorted(files.items())

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the tables and the scene's images; all must be there."""
        files = self.named_files()
        for name, path in files:
            if not path.exists():
                raise RecordingError(
                    "missing",
                    file=path,
                    place=f"scene {self.scene['name']}",
                    expected=f"the file {name} of sample_data.json",
                    remedy="download and extract all archives of file blobs"
                    + (", or read annotated frames only: --option sweeps=no" if name.startswith("sweeps/") else ""),
                )
        return files

    @cached_property
    def _image_paths(self) -> dict[str, list[Path]]:
        """The files of the images by channel."""
        root, file = self.tables.root, self.tables.folder / "sample_data.json"
        return {
            channel: require_files_inside(root, rows.filename.to_pylist(), file=file)
            for channel, rows in self._cameras.items()
        }

    def track(self) -> Track:
        """Return the ego poses at the rows of all sensors: cameras, lidar and radars."""
        poses = self.tables.poses
        rows = np.unique(self._data.pose)
        rows = rows[np.argsort(poses.timestamp_us[rows], kind="stable")]
        state = np.column_stack([poses.timestamp_us[rows], poses.rotation[rows], poses.translation[rows]])
        # Sensors that are exposed together have one pose.
        rows = rows[np.concatenate([[True], (np.diff(state, axis=0) != 0.0).any(axis=1)])]
        stamps_us, rotation, translation = poses.timestamp_us[rows], poses.rotation[rows], poses.translation[rows]
        file = self.tables.folder / "ego_pose.json"

        def place(row: int) -> str:
            return f"scene {self.scene['name']}, {stamps_us[row]} us"

        faults, unit = mark_rotations(rotation, file=file, place=place)
        bad_time = np.abs(stamps_us) > _LAST_US
        faults.add(
            bad_time,
            "time",
            lambda row: RecordingError(
                "the stamp is none", file=file, place=place(row), expected="Unix microseconds", remedy=REMEDY
            ),
        )
        stamps = np.where(bad_time, 0, stamps_us) * 1_000
        has_height = bool(translation[:, 2].any())
        if self._frame is None:
            x, y, z = translation.T
            track = Track(stamps, x_m=x, y_m=y, height_m=z if has_height else None, rotation=unit, file=file)
        else:
            track = track_from_tangent(stamps, translation, unit, self._frame, file=file)
            track = track if has_height else replace(track, height_m=None)
        return faults.drop_from(track)

    def calibrations(self) -> pa.Table:
        """Return the rectified cameras of ``calibrated_sensor``."""
        calibrations: list[tuple[Stage, Calibration]] = []
        for channel, rows in self._cameras.items():
            numbers = np.unique(rows.sensor).tolist()
            for number in numbers:
                mine = np.flatnonzero(rows.sensor == number)
                stamps = rows.timestamp_us[mine] * 1_000
                span = (int(stamps[0]), int(stamps[-1])) if len(numbers) > 1 else (None, None)
                size = rows.size_px[mine[0]].tolist()
                calibrations.append(("factory", self._calibration(channel, number, size, span)))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def _calibration(
        self, channel: str, number: int, size_px: Sequence[int], span: tuple[int | None, int | None]
    ) -> Calibration:
        file, sensor = self.tables.folder / "calibrated_sensor.json", self.tables.sensors[number]
        with entry_errors(file, f"token {sensor.token} ({channel})", "camera_intrinsic, rotation and translation"):
            matrix = np.array(sensor.record["camera_intrinsic"], np.float64)
            if matrix.shape != (3, 3):
                raise ValueError(f"a matrix of shape {matrix.shape}")
            if matrix[0, 1] or matrix[1, 0] or matrix[2].tolist() != [0.0, 0.0, 1.0]:
                raise ValueError(f"{matrix.tolist()} is not a matrix of focal lengths and a principal point")
            mounting = tuple(float(value) for key in ("rotation", "translation") for value in sensor.record[key])
        return make_calibration(
            file,
            _CANONICAL.get(channel, to_identifier(channel)),
            model="pinhole",
            width_px=size_px[0],
            height_px=size_px[1],
            fx_px=float(matrix[0, 0]),
            fy_px=float(matrix[1, 1]),
            # The devkit follows OpenCV: the centre of the first pixel is at 0.
            cx_px=float(matrix[0, 2]) + 0.5,
            cy_px=float(matrix[1, 2]) + 0.5,
            ego_SE3_camera=mounting,
            valid_from_ns=span[0],
            valid_to_ns=span[1],
            method="nuScenes calibrated_sensor, images rectified",
        )

    def images(self) -> Mapping[str, ImageStream]:
        """Return the images of each camera at their native rate; a stamp is taken as mid-exposure."""
        streams: dict[str, ImageStream] = {}
        for channel, rows in self._cameras.items():
            name = _CANONICAL.get(channel, to_identifier(channel))
            paths = tuple(self._image_paths[channel])
            stamps: Int64 = np.clip(rows.timestamp_us, -_LAST_US, _LAST_US) * 1_000
            streams[name] = FileStream(name, codec_of_name(paths[0]), stamps, stamps, paths)
        return streams

    def lidars(self) -> Sequence[LidarSweeps]:
        """Return the sweeps of each lidar; with the option ``sweeps=no`` those of annotated frames."""
        data = self._data if self.sweeps else self._data.take(self._data.key_frame)
        return read_sweeps(self.tables, data, _LAST_US)

    def boxes(self) -> pa.Table | None:
        """Return the boxes of the annotated frames, with velocities; None without boxes, as in the test split."""
        annotations = self.tables.annotations_of(self.scene)
        if not len(annotations.timestamp_us):
            return None
        poses, rows = self.tables.poses, np.unique(self._data.pose)
        return make_boxes(
            annotations,
            self.tables.instances,
            poses.timestamp_us[rows],
            poses.rotation[rows],
            poses.translation[rows],
            version=self.tables.folder.resolve().name,
            file=self.tables.folder / "sample_annotation.json",
        )


# Larger numbers of microseconds overflow int64 nanoseconds: the year 2262.
_LAST_US: Final = 9_000_000_000_000_000
_NIGHT: Final = re.compile(r"\bnight\b", re.IGNORECASE)
_RAIN: Final = re.compile(r"(?<!after )(?<!no )\brain(?:y|ing)?\b", re.IGNORECASE)
_LIGHT: Final = ("day", "dusk", "night")


def parse_description(description: str) -> tuple[str | None, str | None]:
    """Return the light and weather that a description's words state; None for what they do not state.

    A phrase between commas may be one of MIRROR's words; the dataset's own descriptions mention night and rain.
    """
    phrases = [phrase.strip().lower() for phrase in description.split(",")]
    light = next((phrase for phrase in phrases if phrase in _LIGHT), "night" if _NIGHT.search(description) else None)
    weather = next((phrase for phrase in phrases if phrase in WEATHER), "rain" if _RAIN.search(description) else None)
    return light, weather
