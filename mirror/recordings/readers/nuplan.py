"""nuPlan: logs as SQLite databases, with eight cameras in folders of blobs, poses at 100 Hz and boxes at 20 Hz.

Facts of the format, from the schema that the dataset publishes and from nuplan-devkit e924167:

- Stamps are Unix microseconds.
- Ego poses are in the UTM zone of the column ``epsg``, at the middle of the rear axle; x forward, y left, z up.
- Cameras have a lens of Brown and Conrady, in OpenCV's order k1 k2 p1 p2 k3, and OpenCV's principal point.
- Boxes are in UTM too, with yaw alone, a velocity and a confidence: they come from an offline detector.
- Calibrations are pickled lists. They are read without executing anything in them (`nuplan_database.load_numbers`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_inverse, rotate
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import track_from_utm
from mirror.recordings.paths import require_files_inside, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, FileStream, ImageStream, RigInfo, Track
from mirror.recordings.readers.box_rows import make_box_table, rotation_about_up, velocity_columns
from mirror.recordings.readers.nuplan_database import REMEDY, is_database, load_numbers, open_database
from mirror.recordings.readers.stored_poses import mark_rotations, require_poses
from mirror.recordings.registry import refuse_options

_TABLES: Final = ("log", "ego_pose", "camera", "image")
_CANONICAL: Final = {
    "CAM_F0": "front_wide",
    "CAM_L0": "front_left",
    "CAM_R0": "front_right",
    "CAM_L2": "rear_left",
    "CAM_R2": "rear_right",
    "CAM_B0": "rear",
}
_CITIES: Final = {
    "us-nv-las-vegas-strip": "Las Vegas",
    "las_vegas": "Las Vegas",
    "us-ma-boston": "Boston",
    "boston": "Boston",
    "us-pa-pittsburgh-hazelwood": "Pittsburgh",
    "pittsburgh": "Pittsburgh",
    "sg-one-north": "Singapore",
    "singapore": "Singapore",
}
_EIGHT: Final = {"CAM_F0", "CAM_L0", "CAM_R0", "CAM_L1", "CAM_R1", "CAM_L2", "CAM_R2", "CAM_B0"}
_BLOBS: Final = "sensor_blobs"
_LEVELS: Final = 4
# Larger numbers of microseconds overflow int64 nanoseconds.
_LAST_US: Final = 9_000_000_000_000_000
_NORTH, _SOUTH = 32600, 32700
_POSE_COLUMNS: Final = ("timestamp", "x", "y", "z", "qw", "qx", "qy", "qz", "epsg")


class NuplanReader:
    """A reader of one log database, with the camera blobs that were downloaded for it."""

    name = "nuplan"
    expects = "a log database of nuPlan, *.db"

    def recognises(self, path: Path) -> bool:
        """Return whether the file is a database with nuPlan's tables."""
        if path.suffix != ".db" or not is_database(path):
            return False
        with open_database(path) as database:
            return database.has_tables(_TABLES)

    def open(self, path: Path, options: Mapping[str, str]) -> NuplanRecording:
        """Open a log.

        The option ``blobs`` is the folder ``sensor_blobs``; by default it is looked for above the database.
        """
        refuse_options(options, ("blobs",), path, self.name)
        if "blobs" in options:
            blobs: Path | None = Path(options["blobs"])
            if not Path(options["blobs"]).is_dir():
                raise RecordingError(
                    "no folder", file=options["blobs"], place="option blobs", expected=f"the folder {_BLOBS}"
                )
        else:
            above = list(path.resolve().parents)[:_LEVELS]
            blobs = next((folder / _BLOBS for folder in above if (folder / _BLOBS).is_dir()), None)
        return NuplanRecording(path, blobs)


@dataclass(frozen=True)
class NuplanRecording:
    """One log of nuPlan.

    Attributes:
        path: the database.
        blobs: the folder ``sensor_blobs``; None: there is none, the recording has poses and boxes alone.
    """

    path: Path
    blobs: Path | None

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; its id is the database's name; vehicle and city come from the table ``log``."""
        with open_database(self.path) as database:
            rows = database.rows("log", ("vehicle_name", "location", "map_version"))
        if len(rows) != 1:
            raise RecordingError(
                f"{len(rows)} rows", file=self.path, place="table log", expected="one log", remedy=REMEDY
            )
        vehicle, location, map_version = (str(value or "") for value in rows[0])
        return DriveInfo(
            drive_id=to_identifier(self.path.stem),
            vehicle_id=to_identifier(vehicle or "nuplan"),
            vehicle_type="unknown",
            time_base="Unix microseconds",
            body_frame="rear_axle",
            city=_CITIES.get(map_version, _CITIES.get(location)) or location or None,
            licence="CC BY-NC-SA 4.0",
        )

    @cached_property
    def _cameras(self) -> dict[str, tuple[str, Int64, list[Path]]]:
        """Token of the calibration, stamps and files of the images by channel; empty if they were not downloaded."""
        if self.blobs is None:
            return {}
        with open_database(self.path) as database:
            rows = database.rows(
                "image",
                ("camera.channel", "hex(camera.token)", "image.timestamp", "image.filename_jpg"),
                join="JOIN camera ON image.camera_token = camera.token",
                order="camera.channel, image.timestamp",
            )
        cameras: dict[str, list[tuple[str, int, str]]] = {}
        for row, (channel, token, stamp, name) in enumerate(rows):
            if (
                not (isinstance(channel, str) and isinstance(stamp, int) and isinstance(name, str))
                or abs(stamp) > _LAST_US
            ):
                raise RecordingError(
                    f"the image {name!r:.60} of {channel!r:.60} at {stamp!r:.60}",
                    file=self.path,
                    place=f"table image, row {row}",
                    expected="a channel, Unix microseconds and the name of a file",
                    remedy=REMEDY,
                )
            cameras.setdefault(channel, []).append((token, stamp, name))
        found = {}
        for channel in sorted(cameras, key=lambda name: (name != "CAM_F0", name)):
            tokens, stamps, names = zip(*cameras[channel])
            files = require_files_inside(self.blobs, names, file=self.path)
            # A log is downloaded with all images of a camera, or with none: then its folder is absent.
            if files[0].parent.is_dir():
                found[channel] = tokens[0], np.array(stamps, np.int64) * 1_000, files
        return found

    @cached_property
    def rig(self) -> RigInfo | None:
        """The cameras whose images were downloaded; the front camera is the reference camera."""
        cameras = tuple(CameraInfo(_name(channel), channel) for channel in self._cameras)
        if not cameras:
            return None
        rig_id = "nuplan" if set(self._cameras) == _EIGHT else f"nuplan_{self.info.drive_id}"[:120]
        return RigInfo(rig_id, cameras, cameras[0].name)

    def named_files(self) -> Sequence[tuple[str, Path]]:
        """Return the database and the images, missing ones included."""
        images = [path for _, _, paths in self._cameras.values() for path in paths]
        listed = [(path.relative_to(self.blobs or path).as_posix(), path) for path in images]
        return sorted([(self.path.name, self.path), *listed])

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the database and the images; all must be there."""
        for _, _, paths in self._cameras.values():
            for path in paths:
                if not path.exists():
                    raise RecordingError(
                        "missing",
                        file=path,
                        expected="every image of the table image",
                        remedy="download and extract the camera archives again, or remove the log's folder of blobs:"
                        " its poses and boxes are then read alone",
                    )
        return self.named_files()

    def track(self) -> Track:
        """Return the ego's poses, on WGS 84 through their UTM zone."""
        with open_database(self.path) as database:
            rows = database.rows("ego_pose", _POSE_COLUMNS, order="timestamp")
            values = database.matrix([row[1:] for row in rows], "ego_pose", _POSE_COLUMNS[1:])
            zone, north = self._zone(values[:, 7])
        stamps_us = np.array([row[0] if isinstance(row[0], int) and abs(row[0]) < 2**62 else 2**62 for row in rows])
        faults, rotation = mark_rotations(values[:, 3:7], file=self.path, place="table ego_pose, row {}".format)
        bad = np.abs(stamps_us) > _LAST_US
        faults.add(
            bad,
            "time",
            lambda row: RecordingError(
                "no stamp",
                file=self.path,
                place=f"table ego_pose, row {row}",
                expected="Unix microseconds",
                remedy=REMEDY,
            ),
        )
        stamps: Int64 = np.where(bad, 0, stamps_us).astype(np.int64) * 1_000
        x, y, z = values[:, :3].T
        track = track_from_utm(
            stamps,
            x,
            y,
            z,
            rotation,
            zone=zone,
            north=north,
            faults=faults,
            locate=lambda row: (self.path, f"table ego_pose, row {row}"),
            file=self.path,
        )
        return faults.drop_from(track)

    def _zone(self, epsg: Any) -> tuple[int, bool]:
        """UTM zone and hemisphere of all poses."""
        codes = np.unique(epsg)
        if len(codes) == 1 and codes[0] == int(codes[0]):
            for base, north in ((_NORTH, True), (_SOUTH, False)):
                if 1 <= codes[0] - base <= 60:
                    return int(codes[0]) - base, north
        raise RecordingError(
            f"epsg {codes[:3].tolist()}" if len(codes) else "no pose",
            file=self.path,
            place="table ego_pose",
            expected="one UTM zone, EPSG 326xx or 327xx",
            remedy=REMEDY,
        )

    def calibrations(self) -> pa.Table:
        """Return the cameras whose images were downloaded."""
        calibrations: list[tuple[Stage, Calibration]] = []
        if self._cameras:
            columns = ("hex(token)", "translation", "rotation", "intrinsic", "distortion", "width", "height")
            with open_database(self.path) as database:
                rows = {row[0]: row[1:] for row in database.rows("camera", columns)}
            calibrations = [
                ("factory", self._calibration(channel, rows[token])) for channel, (token, _, _) in self._cameras.items()
            ]
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def _calibration(self, channel: str, row: tuple[Any, ...]) -> Calibration:
        place = f"table camera, {channel}"
        shapes = ((3,), (4,), (3, 3), (5,))
        translation, rotation, matrix, distortion = (
            load_numbers(blob, shape, file=self.path, place=place) for blob, shape in zip(row, shapes)
        )
        return make_calibration(
            self.path,
            _name(channel),
            model="brown_conrady",
            width_px=row[4],
            height_px=row[5],
            fx_px=matrix[0, 0],
            fy_px=matrix[1, 1],
            # nuPlan follows OpenCV: the centre of the first pixel is at 0.
            cx_px=matrix[0, 2] + 0.5,
            cy_px=matrix[1, 2] + 0.5,
            distortion=tuple(distortion.tolist()),
            ego_SE3_camera=(*rotation.tolist(), *translation.tolist()),
            method="nuPlan table camera",
        )

    def images(self) -> Mapping[str, ImageStream]:
        """Return the images of each camera; a stamp is taken as mid-exposure, exposure lengths are not recorded."""
        return {
            _name(channel): FileStream(_name(channel), "jpeg", stamps, stamps, tuple(paths))
            for channel, (_, stamps, paths) in self._cameras.items()
        }

    def boxes(self) -> pa.Table | None:
        """Return the boxes of the offline detector, with velocity and confidence; None if the log has none."""
        numbers = ("x", "y", "z", "yaw", "length", "width", "height", "vx", "vy", "vz", "confidence")
        pose = _POSE_COLUMNS[1:8]
        with open_database(self.path) as database:
            if not database.has_tables(("lidar_box", "lidar_pc", "track", "category")):
                return None
            rows = database.rows(
                "lidar_box",
                (
                    "lidar_pc.timestamp",
                    "lower(hex(lidar_box.track_token))",
                    "category.name",
                    *(f"lidar_box.{name}" for name in numbers),
                    *(f"ego_pose.{name}" for name in pose),
                ),
                join="JOIN lidar_pc ON lidar_box.lidar_pc_token = lidar_pc.token"
                " JOIN ego_pose ON lidar_pc.ego_pose_token = ego_pose.token"
                " JOIN track ON lidar_box.track_token = track.token"
                " JOIN category ON track.category_token = category.token",
                order="lidar_pc.timestamp, lidar_box.track_token",
            )
            ((count,),) = database.rows("lidar_box", ("count(*)",))
            values = database.matrix([row[3:] for row in rows], "lidar_box", (*numbers, *pose))
        if count != len(rows):
            raise RecordingError(
                f"{count - len(rows)} of {count} boxes name a lidar_pc, pose, track or category that does not exist",
                file=self.path,
                place="table lidar_box",
                expected="tokens of those tables",
                remedy=REMEDY,
            )
        if not rows:
            return None
        stamps = [row[0] for row in rows]
        if not all(isinstance(stamp, int) and abs(stamp) <= _LAST_US for stamp in stamps):
            raise RecordingError("no stamp", file=self.path, place="table lidar_pc", expected="Unix microseconds")
        place = "table lidar_box, row {}".format
        yaw = rotation_about_up(np.nan_to_num(values[:, 3]))
        utm_SE3_box = require_poses(yaw, values[:, :3], file=self.path, place=place)
        utm_SE3_ego = require_poses(values[:, 14:18], values[:, 11:14], file=self.path, place=place)
        # The difference first: UTM coordinates have seven digits before the point.
        shifted = Poses(utm_SE3_ego.rotation, np.zeros((len(rows), 3)))
        box = Poses(utm_SE3_box.rotation, utm_SE3_box.translation - utm_SE3_ego.translation)
        velocity = rotate(quaternion_inverse(utm_SE3_ego.rotation), np.nan_to_num(values[:, 7:10]))
        columns = {
            "timestamp_ns": np.array(stamps, np.int64) * 1_000,
            "track_id": [row[1] for row in rows],
            "category": [str(row[2]) for row in rows],
            "score": pa.array(np.ascontiguousarray(values[:, 10]), mask=np.isnan(values[:, 10])),
            **velocity_columns(np.where(np.isnan(values[:, 7:10]), np.nan, velocity)),
            "source": "nuplan",
            "source_version": "v1.1",
        }
        return make_box_table(shifted.inverse() @ box, values[:, 4:7], columns)


def _name(channel: str) -> str:
    return _CANONICAL.get(channel, to_identifier(channel))
