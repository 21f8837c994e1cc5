"""DGP (Toyota Research Institute's Dataset Governance Policy): short scenes of several cameras with poses and 3D boxes.

A scene folder holds ``scene_*.json``, which names all other files. Facts of the format, checked on the tests' scene:

- Extrinsics are ``vehicle_SE3_sensor``; the vehicle frame is x forward, y left, z up, with its origin on the ground.
  Every image and point cloud has its own ``world_SE3_sensor``; the vehicle's pose is this times the inverse extrinsic.
- Stamps are ISO 8601 in UTC. Some releases wrote them ten times too large (a drive of 2019 in the year 2464): a stamp
  beyond 2200 is divided by ten.
- The world frame is metric and belongs to the scene; it has no geodetic reference.
- The boxes of the point clouds are the complete set (x along the length, y the width, z the height). The boxes of the
  images are the same boxes in the frame of each camera.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import mark_invalid_rotations
from mirror.recordings.lidars import LidarSweeps
from mirror.recordings.opening import require_file
from mirror.recordings.paths import require_inside, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, FileStream, ImageStream, RigInfo, Track
from mirror.recordings.raster import codec_of_name
from mirror.recordings.readers.box_rows import make_box_table
from mirror.recordings.readers.dgp_datum import Datum, read_datum, read_object, read_pose, require_text
from mirror.recordings.readers.json_tables import entry_errors
from mirror.recordings.readers.stored_poses import join_poses
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults

_BOXES_3D: Final = "1"
_BROWN: Final = ("k1", "k2", "p1", "p2", "k3")
_RATIONAL: Final = (*_BROWN, "k4", "k5", "k6")
_FISHEYE: Final = ("k1", "k2", "k3", "k4")
_FOCAL: Final = ("fx", "fy", "cx", "cy")
_PLAIN: Final = {*_FOCAL, "fov", "fisheye"}


class DgpReader:
    """A reader of one DGP scene."""

    name = "dgp"
    expects = "a folder with one scene_*.json"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder holds one scene file."""
        return len(_scene_files(path)) == 1

    def open(self, path: Path, options: Mapping[str, str]) -> DgpRecording:
        """Open a scene; there are no options."""
        refuse_options(options, (), path, self.name)
        files = _scene_files(path)
        if len(files) != 1:
            raise RecordingError(f"{len(files)} scene files", file=path, expected=self.expects)
        return DgpRecording(path, require_file(path, files[0]))


def _scene_files(path: Path) -> list[str]:
    return sorted(file.name for file in path.glob("scene_*.json")) if path.is_dir() else []


@dataclass(frozen=True)
class DgpRecording:
    """A scene with its cameras, poses and boxes."""

    path: Path
    scene_file: Path

    @cached_property
    def _scene(self) -> dict[str, Any]:
        return read_object(self.scene_file)

    @cached_property
    def _all_data(self) -> list[Datum]:
        calibration: dict[str, str] = {}
        for number, sample in enumerate(self._list("samples")):
            with entry_errors(
                self.scene_file, f"samples[{number}]", "a DGP sample with calibration_key and datum_keys"
            ):
                calibration |= dict.fromkeys(sample["datum_keys"], require_text(sample["calibration_key"]))
        data = []
        for number, entry in enumerate(self._list("data")):
            with entry_errors(
                self.scene_file, f"data[{number}]", "a DGP datum with key, id, and an image or point cloud"
            ):
                data.append(read_datum(entry, calibration))
        if not any(datum.kind == "image" and datum.timestamp_ns is not None for datum in data):
            raise RecordingError("no images", file=self.scene_file, expected="at least one image among the data")
        return data

    def _list(self, key: str) -> list[Any]:
        values = self._scene.get(key)
        if not isinstance(values, list):
            problem = "the key is missing" if values is None else f"{values!r:.80} is not a list"
            raise RecordingError(
                f"not a DGP scene: {problem}",
                file=self.scene_file,
                place=key,
                expected="lists of samples and data",
                remedy="copy the scene file again",
            )
        return values

    @cached_property
    def _data(self) -> list[Datum]:
        """All data that have a stamp, in order of time."""
        stamped = [datum for datum in self._all_data if datum.timestamp_ns is not None]
        return sorted(stamped, key=lambda datum: (datum.timestamp_ns or 0, datum.sensor))

    @cached_property
    def _cameras(self) -> list[str]:
        return sorted({datum.sensor for datum in self._data if datum.kind == "image"})

    @cached_property
    def _extrinsics(self) -> dict[tuple[str, str], Poses]:
        poses = {}
        for key, entry in self._calibration_files.items():
            for name, extrinsic in zip(entry["names"], entry["extrinsics"]):
                file = self.path / "calibration" / f"{key}.json"
                expected = "a rotation qw qx qy qz and a translation x y z"
                with entry_errors(file, f"extrinsics of {name}", expected):
                    poses[key, name] = read_pose(extrinsic)
        return poses

    @cached_property
    def _calibration_files(self) -> dict[str, dict[str, Any]]:
        keys = sorted({datum.calibration for datum in self._data})
        files = {}
        for key in keys:
            require_inside(self.path, f"calibration/{key}.json", file=self.scene_file, place="calibration_key")
            file = require_file(self.path, f"calibration/{key}.json")
            files[key] = read_object(file)
            with entry_errors(file, "the whole document", "lists of names, extrinsics and intrinsics of one length"):
                lengths = {len(files[key][name]) for name in ("names", "extrinsics", "intrinsics")}
                if len(lengths) != 1 or lengths == {0}:
                    raise ValueError("lists of different lengths, or empty ones")
        return files

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; its id and the name of its local frame are the folder's name and the scene's hash."""
        drive_id = to_identifier(f"{self.path.resolve().name}_{self.scene_file.stem.removeprefix('scene_')[:8]}")
        return DriveInfo(
            drive_id=drive_id,
            vehicle_id=to_identifier(f"dgp_{self._scene.get('log') or drive_id}"),
            vehicle_type="unknown",
            time_base="UTC (ISO 8601)",
            frame=drive_id,
            body_frame="vehicle",
            is_clip=True,
        )

    @property
    def rig(self) -> RigInfo:
        """The cameras under their own names; the first camera is the reference camera."""
        cameras = tuple(CameraInfo(name, name) for name in self._cameras)
        return RigInfo(f"dgp_{self._data[0].calibration[:8]}", cameras, self._cameras[0])

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return all files that the scene names, except the point clouds."""
        names = [self.scene_file.name, *(f"calibration/{key}.json" for key in self._calibration_files)]
        names += [f"ontology/{key}.json" for key in self._ontology_keys]
        names += [datum.content["filename"] for datum in self._data if datum.kind == "image"]
        names += [name for _, name in self._box_files]
        return [(name, self._inside(name)) for name in sorted(set(names))]

    def _inside(self, name: str) -> Path:
        return require_inside(self.path, name, file=self.scene_file, place=name)

    def _required(self, name: str) -> Path:
        self._inside(name)
        return require_file(self.path, name)

    def _extrinsic(self, key: str, sensor: str) -> Poses:
        if (key, sensor) not in self._extrinsics:
            raise RecordingError(
                f"no extrinsics of {sensor}",
                file=self.path / "calibration" / f"{key}.json",
                expected="every sensor of the scene",
            )
        return self._extrinsics[key, sensor]

    def track(self) -> Track:
        """Return the vehicle's poses at the stamps of the point clouds and of the reference camera.

        The other cameras are left out: at one stamp their poses differ from the reference camera's by up to 10 mm,
        because the exposures are a millisecond apart and share a stamp.
        """
        used = [datum for datum in self._data if self._is_used(datum)]
        quaternion = np.array([datum.rotation for datum in used])
        unit, bad = mark_invalid_rotations(quaternion)
        torn = [
            (0, self._error(f"datum {number}", f"{datum.stamp!r} is not a date and time", "ISO 8601"))
            for number, datum in enumerate(self._all_data)
            if datum.timestamp_ns is None
        ]
        faults = RowFaults(len(used), torn, reason="time")
        faults.add(
            bad,
            "rotation",
            lambda row: self._error(
                f"{used[row].sensor} at {used[row].timestamp_ns} ns",
                f"{quaternion[row].tolist()} is no rotation",
                "a unit quaternion, qw qx qy qz",
            ),
        )
        translation = np.array([datum.translation for datum in used])
        not_finite = ~np.isfinite(translation).all(axis=1)
        faults.add(
            not_finite,
            "number",
            lambda row: self._error(
                f"{used[row].sensor} at {used[row].timestamp_ns} ns",
                f"the translation {translation[row].tolist()} is not finite",
                "metres x y z",
            ),
        )
        world_SE3_sensor = Poses(unit, np.where(not_finite[:, None], 0.0, translation))
        world_SE3_vehicle = join_poses(
            [
                world_SE3_sensor[row : row + 1] @ self._extrinsic(datum.calibration, datum.sensor).inverse()
                for row, datum in enumerate(used)
            ]
        )
        x, y, z = world_SE3_vehicle.translation.T
        return faults.drop_from(
            Track(
                np.array([datum.timestamp_ns for datum in used], np.int64),
                x_m=x,
                y_m=y,
                height_m=z,
                rotation=world_SE3_vehicle.rotation,
                file=self.scene_file,
            )
        )

    def _is_used(self, datum: Datum) -> bool:
        return datum.kind != "image" or datum.sensor == self._cameras[0]

    def _error(self, place: str, problem: str, expected: str) -> RecordingError:
        remedy = "correct the scene file, or remove the datum from it"
        return RecordingError(problem, file=self.scene_file, place=place, expected=expected, remedy=remedy)

    def calibrations(self) -> pa.Table:
        """Return one factory row per camera and calibration that the scene uses."""
        calibrations: list[tuple[Stage, Calibration]] = []
        for name in self._cameras:
            data = [datum for datum in self._data if datum.sensor == name]
            for key in sorted({datum.calibration for datum in data}):
                stamps = [datum.timestamp_ns for datum in data if datum.calibration == key]
                span = (stamps[0], stamps[-1]) if len(self._calibration_files) > 1 else (None, None)
                calibrations.append(("factory", self._calibration(name, key, data[0].content, span)))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def _calibration(
        self, camera: str, key: str, content: Mapping[str, Any], span: tuple[int | None, int | None]
    ) -> Calibration:
        mounting = self._extrinsic(key, camera)
        entry = self._calibration_files[key]
        file = self.path / "calibration" / f"{key}.json"
        with entry_errors(file, f"intrinsics of {camera}", "numbers by name: fx, fy, cx, cy and coefficients"):
            given: Mapping[str, Any] = entry["intrinsics"][entry["names"].index(camera)]
            intrinsics = dict.fromkeys(_FOCAL, 0.0) | {name: float(value) for name, value in given.items()}
        model, distortion = _camera_model(intrinsics, file, camera)
        return make_calibration(
            file,
            camera,
            model=model,
            width_px=content["width"],
            height_px=content["height"],
            fx_px=intrinsics["fx"],
            fy_px=intrinsics["fy"],
            # DGP follows OpenCV: the centre of the first pixel is at 0.
            cx_px=intrinsics["cx"] + 0.5,
            cy_px=intrinsics["cy"] + 0.5,
            distortion=distortion,
            ego_SE3_camera=to_pose_numbers(mounting),
            valid_from_ns=span[0],
            valid_to_ns=span[1],
            method=f"DGP calibration {key}",
        )

    def images(self) -> Mapping[str, ImageStream]:
        """Return images of each camera; the stamp is taken as mid-exposure, and exposure lengths are not recorded."""
        streams = {}
        for name in self._cameras:
            data = [datum for datum in self._data if datum.sensor == name]
            paths = tuple(self._inside(datum.content["filename"]) for datum in data)
            stamps: Int64 = np.array([datum.timestamp_ns for datum in data], np.int64)
            streams[name] = FileStream(name, codec_of_name(paths[0]), stamps, stamps, paths)
        return streams

    def lidars(self) -> Sequence[LidarSweeps]:
        """Return the point clouds of each lidar."""
        sweeps = []
        for name in sorted({datum.sensor for datum in self._clouds}):
            data = [datum for datum in self._clouds if datum.sensor == name]
            with entry_errors(self.scene_file, f"point clouds of {name}", "a filename for each"):
                files = [require_text(datum.content["filename"]) for datum in data]
            uris = tuple(str(self._inside(file).absolute()) for file in files)
            form = f"dgp_{PurePosixPath(files[0]).suffix[1:] or 'point_cloud'}"
            stamps: Int64 = np.array([datum.timestamp_ns for datum in data], np.int64)
            mounted = join_poses([self._extrinsic(datum.calibration, name) for datum in data])
            sweeps.append(LidarSweeps(name, form, stamps, uris, mounted))
        return tuple(sweeps)

    @property
    def _clouds(self) -> list[Datum]:
        return [datum for datum in self._data if datum.kind == "point_cloud"]

    @property
    def _box_files(self) -> list[tuple[Datum, str]]:
        return [(datum, datum.content["annotations"][_BOXES_3D]) for datum in self._clouds if _has_boxes(datum)]

    @property
    def _ontology_keys(self) -> list[str]:
        with entry_errors(self.scene_file, "ontologies", "keys of ontologies by kind of annotation"):
            key = (self._scene.get("ontologies") or {}).get(_BOXES_3D)
            return [require_text(key)] if key and self._box_files else []

    def _categories(self, file: Path) -> dict[Any, str]:
        """Names of the classes of an ontology, by id."""
        with entry_errors(file, "items", "a list of classes with id and name"):
            return {item["id"]: require_text(item["name"]) for item in read_object(file)["items"]}

    def boxes(self) -> pa.Table | None:
        """Return the boxes of the point clouds in the vehicle frame; None if no point cloud has boxes."""
        if not self._box_files or not self._ontology_keys:
            return None
        ontology = self._ontology_keys[0]
        categories = self._categories(self._required(f"ontology/{ontology}.json"))
        columns: dict[str, list[Any]] = {name: [] for name in ("timestamp_ns", "track_id", "category")}
        vehicle_SE3_box: list[Poses] = []
        size_m: list[list[float]] = []
        for datum, name in self._box_files:
            vehicle_SE3_sensor = self._extrinsic(datum.calibration, datum.sensor)
            file = self._required(name)
            with entry_errors(file, "annotations", "a list of annotations"):
                annotations = list(read_object(file)["annotations"])
            for index, annotation in enumerate(annotations):
                with entry_errors(file, f"annotations[{index}]", "a DGP 3D box of a class in the ontology"):
                    box = annotation["box"]
                    vehicle_SE3_box.append(vehicle_SE3_sensor @ read_pose(box["pose"]))
                    columns["timestamp_ns"].append(datum.timestamp_ns)
                    columns["track_id"].append(str(annotation["instance_id"]))
                    columns["category"].append(categories[annotation["class_id"]])
                    size_m.append([float(box[size]) for size in ("length", "width", "height")])
        shared = {"source": "dgp", "source_version": ontology[:8]}
        return make_box_table(join_poses(vehicle_SE3_box), np.array(size_m).reshape(-1, 3), {**columns, **shared})


def _has_boxes(datum: Datum) -> bool:
    return _BOXES_3D in (datum.content.get("annotations") or {})


def _camera_model(intrinsics: Mapping[str, Any], file: Path, camera: str) -> tuple[Any, tuple[float, ...]]:
    names: tuple[str, ...]
    used = {name for name, value in intrinsics.items() if value} - _PLAIN
    if intrinsics.get("fisheye"):
        model, names = "kannala_brandt", _FISHEYE
    elif not used:
        return "pinhole", ()
    else:
        model, names = ("brown_conrady", _BROWN) if used <= set(_BROWN) else ("rational", _RATIONAL)
    if used - set(names):
        raise RecordingError(
            f"camera model with {', '.join(sorted(used - set(names)))} is not supported",
            file=file,
            place=f"camera {camera}",
            expected="pinhole, Brown-Conrady, rational or fisheye (k1 to k4), without skew",
        )
    return model, tuple(float(intrinsics.get(name, 0.0)) for name in names)
