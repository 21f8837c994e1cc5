"""COLMAP: a reconstructed collection of images as a recording, one drive for each folder of camera folders.

A model is a set of posed images, without time and, unless it was aligned, without scale and direction:

- Names: ``DRIVE/CAMERA/IMAGE``, ``CAMERA/IMAGE`` or ``IMAGE``. The folder of an image is its camera, the folders above
  it are its drive: the drives of a model have the paths ``FOLDER/DRIVE``.
- Time: a name of 16 or 19 digits is Unix microseconds or nanoseconds. Else the images are put in the order of their
  names, at a rate that the user may state.
- The ego frame is the reference camera's origin with x forward, y left, z up. A camera's mounting is the mean of its
  poses relative to the reference camera; for a rig of COLMAP these are all equal. Every image keeps its own pose: the
  track has a pose at every image.
- The world is the model's, in metres if the model is. ``origin`` places it on WGS 84 as an east-north-up tangent frame.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.geometry.quaternions import quaternion_inverse, quaternion_multiply, rotate
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import FLU_FROM_CAMERA, track_from_tangent
from mirror.recordings.paths import natural_key, require_files_inside, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, FileStream, ImageStream, RigInfo, Track
from mirror.recordings.raster import codec_of_name
from mirror.recordings.readers.collection import choose_drive
from mirror.recordings.readers.colmap_folders import model_folders, name_choice
from mirror.recordings.readers.colmap_lenses import to_lens
from mirror.recordings.readers.colmap_model import ColmapModel, read_model
from mirror.recordings.readers.colmap_settings import OPTIONS, ColmapSettings, read_settings
from mirror.recordings.readers.stored_poses import join_poses
from mirror.recordings.registry import refuse_options
from mirror.recordings.time import SECOND_NS

_STAMP: Final = re.compile(r"\d{16}|\d{19}")
# Poses of the reference camera further apart than this do not give a pose between them.
_GAP_NS: Final = 2 * SECOND_NS
_SINGLE: Final = "drive"


class ColmapReader:
    """A reader of the drives of a folder with a COLMAP model and its images."""

    name = "colmap"
    expects = "a folder with images/ and a model of COLMAP in sparse/NUMBER, sparse, colmap or itself, or FOLDER/DRIVE"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder holds a model and a folder of images."""
        return path.is_dir() and (path / "images").is_dir() and bool(model_folders(path))

    def drives(self, path: Path) -> Sequence[str]:
        """Return the names of the drives; images outside folders of drives form one drive with a fixed name."""
        folder = next(iter(model_folders(path)), "")
        return list(_by_drive(read_model(path, folder).images.name))

    def open(self, path: Path, options: Mapping[str, str]) -> ColmapRecording:
        """Open a drive.

        Options: ``model`` and ``images`` are folders in the recording; ``stamps`` is ``auto``, ``name`` or ``order``;
        ``rate_hz`` is the rate of images in ``order`` (1); ``scale`` is the length of the model's unit in metres (1);
        ``up`` is ``z`` (the model's z) or ``images`` (the mean of the images' upward direction); ``origin`` is
        ``longitude,latitude,height`` of the model's origin; ``frame`` names the local frame.
        """
        refuse_options(options, OPTIONS, path, self.name)
        settings = read_settings(options, path)
        root, name = path, None
        models = model_folders(path) if path.is_dir() else {}
        if (not models and "model" not in options) or not path.exists():
            root, name = path.parent, path.name
            models = model_folders(root) if root.is_dir() else {}
        if not models and "model" not in options:
            raise RecordingError("no model of COLMAP", file=path, expected=self.expects)
        folder = options.get("model", next(iter(models), ""))
        model = read_model(root, folder)
        drives = _by_drive(model.images.name)
        chosen = choose_drive(list(drives), name, root)
        return ColmapRecording(root, model, chosen, drives[chosen], settings, name_choice(models, folder))


def _by_drive(names: Sequence[str]) -> dict[str, list[int]]:
    """Rows of the images by drive, in the order of the drives' names."""
    rows: dict[str, list[int]] = defaultdict(list)
    for row, name in enumerate(names):
        drive = name.rpartition("/")[0].rpartition("/")[0]
        rows[to_identifier(drive) if drive else _SINGLE].append(row)
    return dict(sorted(rows.items()))


@dataclass(frozen=True)
class _Sensor:
    """Images of one camera of COLMAP under one name.

    Attributes:
        name: the camera's name.
        camera_id: COLMAP's id.
        rows: rows of the images in order of time.
        ego_SE3_camera: the mounting.
        method: how the mounting was obtained.
    """

    name: str
    camera_id: int
    rows: Int64
    ego_SE3_camera: Poses
    method: str


@dataclass(frozen=True)
class ColmapRecording:
    """The images of one drive.

    Attributes:
        path: the recording's folder.
        model: the model.
        drive: the drive's name.
        rows: rows of its images in the model.
        settings: the options.
        notes: what is said of the choice among several models.
    """

    path: Path
    model: ColmapModel
    drive: str
    rows: Sequence[int]
    settings: ColmapSettings
    notes: tuple[str, ...] = ()

    @property
    def _is_single(self) -> bool:
        return self.drive == _SINGLE

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; its id is its own name, or the folder's name if the model is one drive."""
        folder = to_identifier(self.path.resolve().name)
        name = folder if self._is_single else self.drive
        by_name = self._stamps_in_names
        return DriveInfo(
            drive_id=name,
            vehicle_id=name,
            vehicle_type="unknown",
            time_base="digits of the images' names" if by_name else f"order of names at {self.settings.rate_hz:g} Hz",
            frame=None if self.settings.origin is not None else self.settings.frame or f"colmap_{folder}"[:120],
            body_frame="camera",
            has_date=by_name,
            has_motion=by_name,
            notes=self.notes,
        )

    @cached_property
    def _names(self) -> list[str]:
        return [self.model.images.name[row] for row in self.rows]

    @cached_property
    def _world_SE3_camera(self) -> Poses:  # noqa: N802
        """(N,) poses of the drive's images in metres, with z up."""
        poses = self.model.images.camera_SE3_world[np.array(self.rows)].inverse()
        position = poses.translation * self.settings.scale
        if self.settings.up == "z":
            return Poses(poses.rotation, position)
        everywhere = self.model.images.camera_SE3_world.inverse().rotation
        turn = _turn_to_z(rotate(everywhere, (0.0, -1.0, 0.0)).mean(axis=0))
        return Poses(quaternion_multiply(turn, poses.rotation), rotate(turn, position))

    @cached_property
    def _stamps_in_names(self) -> bool:
        stems = [name.rpartition("/")[2].rpartition(".")[0] for name in self._names]
        odd = next((stem for stem in stems if not _STAMP.fullmatch(stem) or len({len(stem), len(stems[0])}) > 1), None)
        if self.settings.stamps == "name" and odd is not None:
            raise RecordingError(
                f"the name {odd!r:.80} is no stamp",
                file=self.model.files["images"],
                expected="16 digits (Unix microseconds) or 19 digits (nanoseconds) in every name",
                remedy="rename the images, or take them in order: --option stamps=order",
            )
        return odd is None and self.settings.stamps != "order"

    @cached_property
    def _stamps(self) -> Int64:
        """(N,) stamp of each image: that of its name, or of its frame in the order of frames."""
        stems = [name.rpartition("/")[2].rpartition(".")[0] for name in self._names]
        if self._stamps_in_names:
            unit = 1_000 if len(stems[0]) == 16 else 1
            stamps = [int(stem) * unit for stem in stems]
            if max(stamps) >= 2**63:
                raise RecordingError(
                    f"the name {max(stems)} is beyond the year 2262",
                    file=self.model.files["images"],
                    expected="Unix nanoseconds",
                    remedy="--option stamps=order",
                )
            return np.array(stamps, np.int64)
        groups = [self._group(row, stem) for row, stem in zip(self.rows, stems)]
        first = dict(sorted(zip(groups, stems), reverse=True))
        order = sorted(first, key=lambda group: (natural_key(first[group]), group))
        step = SECOND_NS / self.settings.rate_hz
        stamp_of = {group: round(number * step) for number, group in enumerate(order)}
        return np.array([stamp_of[group] for group in groups], np.int64)

    def _group(self, row: int, stem: str) -> str:
        """Return what the images of one instant share: their frame, or else their names without the folder."""
        image = self.model.images.image_id[row]
        frame = self.model.frame_of.get(image)
        shared = frame is not None and self._frame_sizes[frame] > 1
        return f"frame {frame}" if shared else stem

    @cached_property
    def _frame_sizes(self) -> dict[int, int]:
        sizes: dict[int, int] = defaultdict(int)
        for frame in self.model.frame_of.values():
            sizes[frame] += 1
        return sizes

    @cached_property
    def _sensors(self) -> list[_Sensor]:
        """The reference camera's first: the camera with most images."""
        by_name: dict[str, dict[int, list[int]]] = defaultdict(lambda: defaultdict(list))
        for number, (row, name) in enumerate(zip(self.rows, self._names)):
            folder = name.rpartition("/")[0].rpartition("/")[2]
            camera = to_identifier(folder) if folder else "camera"
            by_name[camera][self.model.images.camera_id[row]].append(number)
        parts: dict[tuple[str, int], Int64] = {}
        for name, by_id in by_name.items():
            ordered = {key: self._ascending(numbers) for key, numbers in by_id.items()}
            split = len(ordered) > 1 and self._overlap(ordered)
            parts |= {(f"{name}_{key}" if split else name, key): numbers for key, numbers in ordered.items()}
        images: dict[str, int] = defaultdict(int)
        for (name, _), numbers in parts.items():
            images[name] += len(numbers)
        reference = min(images, key=lambda name: (-images[name], name != "front_wide", name))
        camera_SE3_flu = Poses(quaternion_inverse(FLU_FROM_CAMERA)[None], np.zeros((1, 3)))
        of_reference = np.concatenate([numbers for (name, _), numbers in parts.items() if name == reference])
        stamps, first = np.unique(self._stamps[of_reference], return_index=True)
        world_SE3_ego = self._world_SE3_camera[of_reference[first]] @ camera_SE3_flu
        sensors = []
        for (name, key), numbers in sorted(parts.items(), key=lambda part: (part[0][0] != reference, part[0])):
            if name == reference:
                sensors.append(_Sensor(name, key, numbers, camera_SE3_flu.inverse(), "the reference camera"))
            else:
                mounting, method = self._mounting(name, numbers, stamps, world_SE3_ego)
                sensors.append(_Sensor(name, key, numbers, mounting, method))
        return sensors

    def _ascending(self, numbers: list[int]) -> Int64:
        chosen = np.array(numbers)
        return chosen[np.argsort(self._stamps[chosen], kind="stable")]

    def _overlap(self, by_id: Mapping[int, Int64]) -> bool:
        """Return whether images of several cameras are mixed in time or differ in size: the cameras are different."""
        cameras = [self.model.cameras[key] for key in by_id]
        if len({(camera.width_px, camera.height_px) for camera in cameras}) > 1:
            return True
        spans = sorted((int(self._stamps[n[0]]), int(self._stamps[n[-1]])) for n in by_id.values())
        return any(after[0] <= before[1] for before, after in pairwise(spans))

    def _mounting(self, name: str, numbers: Int64, stamps: Int64, world_SE3_ego: Poses) -> tuple[Poses, str]:
        """The mean pose of a camera in the ego frame, and how it was obtained."""
        mine = self._stamps[numbers]
        inside = (mine >= stamps[0]) & (mine <= stamps[-1])
        after = np.clip(np.searchsorted(stamps, mine), 0, len(stamps) - 1)
        before = np.maximum(after - 1, 0)
        same = stamps[after] == mine
        usable = same if same.any() else inside & (stamps[after] - stamps[before] <= _GAP_NS)
        if not usable.any():
            raise RecordingError(
                f"no image of camera {name} has the time of images of the reference camera",
                file=self.model.files["images"],
                place=f"camera {name}",
                expected="cameras that take images together, in one frame of COLMAP or under one name",
                remedy=f"put the images of {name} into the folder of another drive: DRIVE/CAMERA/IMAGE",
            )
        ego = interpolate(stamps, world_SE3_ego, mine[usable])
        mounted = ego.inverse() @ self._world_SE3_camera[numbers[usable]]
        mean = _mean_pose(mounted)
        off = (mean.inverse() @ mounted).log()
        spread = np.sqrt((off**2).reshape(-1, 2, 3).sum(axis=2).mean(axis=0))
        method = f"mean of {len(mounted)} frames, spread {np.degrees(spread[0]):.3g} deg and {spread[1]:.3g} m"
        return mean, method

    @property
    def rig(self) -> RigInfo:
        """The cameras; the camera with the most images is the reference camera."""
        names = list(dict.fromkeys(sensor.name for sensor in self._sensors))
        rig_id = f"colmap_{self.info.drive_id}"[:120]
        return RigInfo(rig_id, tuple(CameraInfo(name, name) for name in names), names[0])

    @cached_property
    def _paths(self) -> list[Path]:
        prefix = f"{self.settings.images}/"
        return require_files_inside(self.path, [prefix + name for name in self._names], file=self.model.files["images"])

    def named_files(self) -> Sequence[tuple[str, Path]]:
        """Return the model's cameras, images and frames, and the drive's images, including missing ones.

        The points are not read.
        """
        paths = [*self.model.files.values(), *self._paths]
        return sorted((path.relative_to(self.path).as_posix(), path) for path in paths)

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the model's cameras, images and frames, and the drive's images; all must be there."""
        for path in self._paths:
            if not path.exists():
                raise RecordingError(
                    "missing",
                    file=path,
                    expected="every registered image of the model",
                    remedy="restore it, or name the folder of images: --option images=FOLDER",
                )
        return self.named_files()

    def track(self) -> Track:
        """Return the ego's pose at every image; for images at one instant, the reference camera's pose counts."""
        poses, stamps = [], []
        for sensor in self._sensors:
            poses.append(self._world_SE3_camera[sensor.rows] @ sensor.ego_SE3_camera.inverse())
            stamps.append(self._stamps[sensor.rows])
        times, first = np.unique(np.concatenate(stamps), return_index=True)
        world_SE3_ego = join_poses(poses)[first]
        rotation, position = world_SE3_ego.rotation, world_SE3_ego.translation
        file = self.model.files["images"]
        if self.settings.origin is not None:
            return track_from_tangent(times, position, rotation, self.settings.origin, file=file)
        x, y, z = position.T
        return Track(times, x_m=x, y_m=y, height_m=z, rotation=rotation, file=file)

    def calibrations(self) -> pa.Table:
        """Return one row for each COLMAP camera; rows with the same name are valid one after the other."""
        calibrations: list[tuple[Stage, Calibration]] = []
        names = [sensor.name for sensor in self._sensors]
        for sensor in self._sensors:
            camera = self.model.cameras[sensor.camera_id]
            lens = to_lens(camera, self.model.files["cameras"], f"camera {sensor.camera_id}")
            stamps = self._stamps[sensor.rows]
            span = (int(stamps[0]), int(stamps[-1])) if names.count(sensor.name) > 1 else (None, None)
            mounting = sensor.ego_SE3_camera
            calibration = make_calibration(
                self.model.files["cameras"],
                sensor.name,
                width_px=camera.width_px,
                height_px=camera.height_px,
                ego_SE3_camera=to_pose_numbers(mounting),
                valid_from_ns=span[0],
                valid_to_ns=span[1],
                method=f"COLMAP {camera.model}; mounting: {sensor.method}",
                **lens,
            )
            calibrations.append(("refined", calibration))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return the registered images of each camera; exposure lengths are not known."""
        rows: dict[str, Int64] = {}
        for sensor in self._sensors:
            rows[sensor.name] = np.concatenate([rows.get(sensor.name, np.empty(0, np.int64)), sensor.rows])
        streams: dict[str, ImageStream] = {}
        for name, unordered in rows.items():
            numbers = unordered[np.argsort(self._stamps[unordered], kind="stable")]
            paths = tuple(self._paths[number] for number in numbers.tolist())
            codec, stamps = codec_of_name(paths[0]), self._stamps[numbers]
            streams[name] = FileStream(name, codec, stamps, stamps, paths)
        return streams

    def boxes(self) -> None:
        """Return None: models have no boxes."""
        return


def _mean_pose(poses: Poses) -> Poses:
    """The mean of (N,) poses: rotations by the largest eigenvector of their quaternions' outer products."""
    outer = poses.rotation.T @ poses.rotation
    rotation: Float64 = np.linalg.eigh(outer)[1][:, -1]
    return Poses(rotation[None], poses.translation.mean(axis=0)[None])


def _turn_to_z(up: Float64) -> Float64:
    """The shortest rotation (4,) that maps a direction to z."""
    length = float(np.linalg.norm(up))
    if not length > 1e-6:
        raise RecordingError("the images have no common upward direction", expected="--option up=z")
    x, y, z = up / length
    if z < -1.0 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    half = np.array([1.0 + z, y, -x, 0.0])
    return half / np.linalg.norm(half)
