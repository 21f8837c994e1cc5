"""KITTI-360: nine long drives through the same suburbs of Karlsruhe, with two rectified cameras and refined poses.

Facts of the format, from the calibration and conversion scripts that the dataset publishes:

- ``data_poses/<drive>/poses.txt`` holds frame numbers and ``world_SE3_imu``. The IMU is x forward, y right, z down. The
  world is Mercator's projection of a sphere of 6,378,137 m, scaled to metres at its origin, a lake in Karlsruhe:
  x east, y north. Only frames that moved have a pose.
- A frame's time is the line of its number in ``timestamps.txt`` of the first camera: date and time without a zone.
- ``calib_cam_to_pose.txt`` holds ``imu_SE3_camera`` before rectification; ``R_rect`` of ``perspective.txt`` turns it.
  Principal points have the centre of the first pixel at 0.
- The fisheye cameras have Mei's model, for which MIRROR has no lens.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_from_matrix, quaternion_inverse, quaternion_multiply, rotate
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import FLU_FROM_FRD
from mirror.recordings.opening import find_file, read_file, require_file
from mirror.recordings.paths import list_folder, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, FileStream, ImageStream, RigInfo, Track
from mirror.recordings.readers.collection import choose_drive, one_of
from mirror.recordings.readers.rotations import REMEDY, is_no_rigid_motion
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.stamps import require_zone

_POSES: Final = "data_poses"
_IMAGES: Final = "data_2d_raw"
_CAMERAS: Final = ("image_00", "image_01")
_FISHEYES: Final = ("image_02", "image_03")
_RADIUS_M: Final = 6378137.0
_ORIGIN: Final = (48.9843445, 8.4295857)
_STAMP: Final = re.compile(r"\d{4}-\d{2}-\d{2} \d{2}:\d{2}:\d{2}(?:\.\d{1,9})?")
_NUMBERS: Final = 13
_ROTATION_TOLERANCE: Final = 1e-2


class Kitti360Reader:
    """Reads the drives of a KITTI-360 folder; each has the path ``FOLDER/2013_05_28_drive_NNNN_sync``."""

    name = "kitti360"
    expects = f"a KITTI-360 folder with {_POSES}/<drive>/poses.txt and calibration/, or FOLDER/<drive>"

    def recognises(self, path: Path) -> bool:
        """Whether the folder holds poses and calibrations."""
        return (path / _POSES).is_dir() and (path / "calibration").is_dir()

    def drives(self, path: Path) -> Sequence[str]:
        """Names of the drives that have poses."""
        return sorted(
            child.name
            for child in (path / _POSES).iterdir()
            if child.is_dir() and find_file(path, f"{_POSES}/{child.name}/poses.txt")
        )

    def open(self, path: Path, options: Mapping[str, str]) -> Kitti360Recording:
        """Open a drive.

        The option ``tz`` is the zone of the stamps, which the dataset does not state (``UTC``, or an IANA name).
        ``fisheye`` is ``no`` (the rectified cameras) or ``yes``, which is refused: there is no lens for them.
        """
        refuse_options(options, ("tz", "fisheye"), path)
        root, name = (path, None) if self.recognises(path) else (path.parent, path.name)
        if not self.recognises(root):
            raise RecordingError("no KITTI-360 folder", file=path, expected=self.expects)
        if one_of(options, "fisheye", ("no", "yes"), path) == "yes":
            raise RecordingError(
                f"the cameras {' and '.join(_FISHEYES)} have the model of Mei, which is not supported",
                file=root / "calibration" / f"{_FISHEYES[0]}.yaml",
                expected="pinhole, brown_conrady, rational, kannala_brandt or f_theta",
                remedy="read the rectified cameras alone: leave the option fisheye out",
            )
        drive = choose_drive(self.drives(root), name, root)
        return Kitti360Recording(root, drive, options.get("tz", "UTC"))


@dataclass(frozen=True)
class Kitti360Recording:
    """One drive.

    Attributes:
        root: the folder of the dataset.
        drive: the drive's name.
        tz: the zone of its stamps.
    """

    root: Path
    drive: str
    tz: str

    @cached_property
    def info(self) -> DriveInfo:
        """All drives have the same vehicle."""
        return DriveInfo(
            drive_id=to_identifier(f"kitti360_{self.drive}"),
            vehicle_id="kitti360",
            vehicle_type="station wagon",
            time_base=f"date and time, taken as {self.tz}",
            body_frame="imu",
            city="Karlsruhe",
            licence="CC BY-NC-SA 3.0",
        )

    def _stamps(self, camera: str) -> tuple[Path, Int64]:
        """The stamp of each frame of a camera; the smallest int64 where a line is none."""
        import pyarrow.compute as pc

        file = find_file(self.root, f"{_IMAGES}/{self.drive}/{camera}/timestamps.txt")
        if file is None:
            raise RecordingError(
                "missing",
                file=self.root / _IMAGES / self.drive / camera / "timestamps.txt",
                expected="the stamps of the frames: without them poses and images have no time",
                remedy="download data_timestamps_perspective.zip",
            )
        lines = read_file(file).decode(errors="replace").splitlines()
        none = np.datetime64("NaT", "ns")
        values = np.array(
            [np.datetime64(line.strip().replace(" ", "T"), "ns") if _is_stamp(line) else none for line in lines],
            "datetime64[ns]",
        )
        known = ~np.isnat(values)
        require_zone(self.tz)
        local = pa.array(values[known], pa.timestamp("ns"))
        utc = pc.assume_timezone(local, self.tz, ambiguous="earliest", nonexistent="earliest").cast(pa.int64())
        stamps = np.full(len(lines), np.iinfo(np.int64).min)
        stamps[known] = np.asarray(utc)
        return file, stamps

    @cached_property
    def _files(self) -> dict[str, dict[int, Path]]:
        """Images by camera and frame."""
        found: dict[str, dict[int, Path]] = {}
        for camera in _CAMERAS:
            folder = self.root / _IMAGES / self.drive / camera / "data_rect"
            if not folder.is_dir():
                continue
            files = {}
            for name, file in list_folder(self.root, folder).items():
                stem, _, suffix = name.rpartition(".")
                if suffix != "png" or not stem.isdecimal() or len(stem) != 10:
                    raise RecordingError(
                        "no image of the camera", file=file, expected="ten digits and .png", remedy="move it elsewhere"
                    )
                files[int(stem)] = file
            if files:
                found[camera] = dict(sorted(files.items()))
        return found

    @cached_property
    def rig(self) -> RigInfo | None:
        """The rectified cameras that have images."""
        cameras = tuple(CameraInfo(camera, camera) for camera in self._files)
        if not cameras:
            return None
        return RigInfo("kitti360" if len(cameras) == 2 else f"kitti360_{cameras[0].name}", cameras, cameras[0].name)

    def files(self) -> Sequence[tuple[str, Path]]:
        """Poses, stamps, calibrations and images of the drive."""
        names = [f"{_POSES}/{self.drive}/poses.txt", "calibration/calib_cam_to_pose.txt", "calibration/perspective.txt"]
        names += [f"{_IMAGES}/{self.drive}/{camera}/timestamps.txt" for camera in _CAMERAS]
        files = [(name, file) for name in names if (file := find_file(self.root, name)) is not None]
        images = [file for by_frame in self._files.values() for file in by_frame.values()]
        return sorted([*files, *((file.relative_to(self.root).as_posix(), file) for file in images)])

    def track(self) -> Track:
        """The IMU's poses, on WGS 84, with axes x forward, y left, z up."""
        file = require_file(self.root, f"{_POSES}/{self.drive}/poses.txt")
        rows, torn = [], []
        for number, line in enumerate(read_file(file).decode(errors="replace").splitlines(), 1):
            words = line.split()
            try:
                if len(words) != _NUMBERS:
                    raise ValueError(f"{len(words)} numbers")
                rows.append([float(word) for word in words])
            except ValueError as problem:
                expected = "a frame and a 3x4 matrix"
                place = f"line {number}"
                fault = RecordingError(str(problem), file=file, place=place, expected=expected, remedy=REMEDY)
                torn.append((len(rows), fault))
        values = np.array(rows, np.float64).reshape(-1, _NUMBERS)
        matrix = values[:, 1:].reshape(-1, 3, 4)
        _, by_frame = self._stamps(_CAMERAS[0])
        frame = values[:, 0]
        known = (frame >= 0) & (frame < len(by_frame)) & (frame == np.floor(frame))
        stamps: Int64 = np.where(known, by_frame[np.where(known, frame, 0).astype(np.int64)] if len(by_frame) else 0, 0)
        known &= stamps != np.iinfo(np.int64).min
        faults = RowFaults(len(values), torn)

        def error(row: int) -> RecordingError:
            return RecordingError(
                f"frame {frame[row]:g} with the matrix {matrix[row].tolist()}",
                file=file,
                place=f"pose {row}",
                expected="a frame that timestamps.txt has, and a rigid 3x4 matrix",
                remedy=REMEDY,
            )

        faults.add(~known, "time", error)
        rotation = matrix[:, :, :3]
        bad = is_no_rigid_motion(matrix, _ROTATION_TOLERANCE)
        faults.add(bad, "rotation", error)
        frd = quaternion_from_matrix(np.where(bad[:, None, None], np.eye(3), rotation))
        flu = quaternion_multiply(frd, quaternion_inverse(FLU_FROM_FRD))
        up = rotate(flu, (0.0, 0.0, 1.0))[:, 2]
        if faults.good.any() and np.median(up[faults.good]) < 0.0:
            raise RecordingError(
                "the vehicle stands on its head",
                file=file,
                expected="an IMU with z down, in a world with z up",
                remedy=REMEDY,
            )
        longitude, latitude = _to_degrees(matrix[:, 0, 3], matrix[:, 1, 3])
        return faults.drop_from(
            Track(
                np.where(known, stamps, 0),
                longitude_deg=longitude,
                latitude_deg=latitude,
                height_m=matrix[:, 2, 3],
                rotation=flu,
                file=file,
            )
        )

    def calibrations(self) -> pa.Table:
        """The rectified cameras that have images."""
        calibrations: list[tuple[Stage, Calibration]] = []
        if self._files:
            lens_file, pose_file = (
                require_file(self.root, f"calibration/{name}.txt") for name in ("perspective", "calib_cam_to_pose")
            )
            lenses, mountings = _read_values(lens_file), _read_values(pose_file)
            for camera in self._files:
                digits = camera[-2:]
                projection = _values(lenses, f"P_rect_{digits}", (3, 4), lens_file)
                rectified = np.eye(4)
                rectified[:3, :3] = _values(lenses, f"R_rect_{digits}", (3, 3), lens_file).T
                width, height = _values(lenses, f"S_rect_{digits}", (2,), lens_file)
                matrix = np.concatenate([_values(mountings, camera, (3, 4), pose_file), [[0.0, 0.0, 0.0, 1.0]]])
                imu_SE3_camera = Poses.from_matrix(matrix) @ Poses.from_matrix(rectified)
                mounting = Poses(FLU_FROM_FRD[None], np.zeros((1, 3))) @ imu_SE3_camera
                calibration = make_calibration(
                    lens_file,
                    camera,
                    model="pinhole",
                    width_px=int(width),
                    height_px=int(height),
                    fx_px=projection[0, 0],
                    fy_px=projection[1, 1],
                    cx_px=projection[0, 2] + 0.5,
                    cy_px=projection[1, 2] + 0.5,
                    ego_SE3_camera=(*mounting.rotation[0].tolist(), *mounting.translation[0].tolist()),
                    method="KITTI-360 perspective.txt, images rectified",
                )
                calibrations.append(("factory", calibration))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """The rectified images; a stamp is taken as mid-exposure, exposure lengths are not recorded."""
        streams: dict[str, ImageStream] = {}
        for camera, files in self._files.items():
            place, by_frame = self._stamps(camera)
            frames = np.fromiter(files, np.int64, len(files))
            inside = frames < len(by_frame)
            stamps: Int64 = np.where(inside, by_frame[np.where(inside, frames, 0)] if len(by_frame) else 0, 0)
            missing = ~inside | (stamps == np.iinfo(np.int64).min)
            if missing.any():
                raise RecordingError(
                    "the frame has no stamp",
                    file=files[int(frames[np.argmax(missing)])],
                    expected=f"a line with its number in {place.name}",
                    remedy="download data_timestamps_perspective.zip again",
                )
            streams[camera] = FileStream(camera, "png", stamps, stamps, tuple(files.values()))
        return streams

    def boxes(self) -> None:
        """None: the dataset's boxes are of static objects in the world, without an instant, and are not read."""
        return


def _is_stamp(line: str) -> bool:
    if not _STAMP.fullmatch(line.strip()):
        return False
    try:
        np.datetime64(line.strip().replace(" ", "T"), "ns")
    except ValueError:
        return False
    return True


def _to_degrees(x_m: Float64, y_m: Float64) -> tuple[Float64, Float64]:
    """Longitude and latitude of the scaled Mercator coordinates of the dataset's world."""
    scale = np.cos(np.radians(_ORIGIN[0])) * _RADIUS_M
    east = scale * np.radians(_ORIGIN[1])
    north = scale * np.log(np.tan(np.radians(90.0 + _ORIGIN[0]) / 2.0))
    with np.errstate(all="ignore"):
        latitude = 2.0 * np.degrees(np.arctan(np.exp((y_m + north) / scale))) - 90.0
        return np.degrees((x_m + east) / scale), latitude


def _read_values(file: Path) -> dict[str, list[str]]:
    """The words of each line ``name: values``."""
    lines = read_file(file).decode(errors="replace").splitlines()
    return {name.strip(): values.split() for name, found, values in (line.partition(":") for line in lines) if found}


def _values(lines: Mapping[str, list[str]], name: str, shape: tuple[int, ...], file: Path) -> Float64:
    try:
        return np.array([float(word) for word in lines[name]], np.float64).reshape(shape)
    except (KeyError, ValueError) as error:
        raise RecordingError(
            "the line is missing" if isinstance(error, KeyError) else f"values that cannot be used ({error})",
            file=file,
            place=name,
            expected=f"numbers of shape {shape}",
            remedy="download the calibration again",
        ) from error
