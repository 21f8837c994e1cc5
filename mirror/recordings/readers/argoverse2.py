"""Argoverse 2, sensor dataset: logs of 15 s with seven ring cameras, a stereo pair, boxes and poses at 200 Hz.

Facts of the format, from the user guide, the devkit av2 0.3.6 and four real logs:

- Stamps are nanoseconds of a clock without a date: a log begins within hours of 1980-01-06 (the GPS epoch).
- ``city_SE3_egovehicle``: the city's frame is the UTM grid of its zone, shifted to an origin near the city's centre.
  The city stands in the names of the map's files. Quaternions may have a negative scalar.
- The ego's origin is the middle of the rear axle, about 0.33 m above the ground; x forward, y left, z up.
- Images are undistorted: ``k1 k2 k3`` of the intrinsics describe the lens before that; the devkit does not use them.
  Its principal points have the centre of the first pixel at 0.
- Boxes are in the ego frame at the stamp of a lidar sweep.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.geometry.geodesy import geodetic_to_utm
from mirror.geometry.poses import COLUMNS, Poses, to_pose_numbers
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import track_from_utm
from mirror.recordings.lidars import LidarSweeps
from mirror.recordings.opening import find_file, require_file
from mirror.recordings.paths import list_folder, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, FileStream, ImageStream, RigInfo, Track
from mirror.recordings.readers.arrow_tables import matrix_of, read_feather
from mirror.recordings.readers.box_rows import make_box_table
from mirror.recordings.readers.stored_poses import mark_rotations, require_poses
from mirror.recordings.registry import refuse_options


class _City(NamedTuple):
    name: str
    zone: int
    latitude_deg: float
    longitude_deg: float


# Zones and origins as in av2.geometry.utm; all lie on the northern hemisphere.
_CITIES: Final = {
    "ATX": _City("Austin", 14, 30.27464237939507, -97.7404457407424),
    "DTW": _City("Detroit", 17, 42.29993066912924, -83.17555750783717),
    "MIA": _City("Miami", 17, 25.77452579915163, -80.19656914449405),
    "PAO": _City("Palo Alto", 10, 37.416065, -122.13571963362166),
    "PIT": _City("Pittsburgh", 17, 40.44177902989321, -80.01294377242584),
    "WDC": _City("Washington", 18, 38.889377, -77.0355047439081),
}
_CITY_OF_MAP: Final = re.compile(r"____([A-Z]{3})(?:_city_\d+)?\.(?:json|npy)")
_CANONICAL: Final = {
    "ring_front_center": "front_wide",
    "ring_front_left": "front_left",
    "ring_front_right": "front_right",
    "ring_rear_left": "rear_left",
    "ring_rear_right": "rear_right",
}
_REFERENCE: Final = "ring_front_center"
_POSES: Final = "city_SE3_egovehicle.feather"
_INTRINSICS: Final = "calibration/intrinsics.feather"
_MOUNTINGS: Final = "calibration/egovehicle_SE3_sensor.feather"
_BOXES: Final = "annotations.feather"
_SIZES: Final = ("length_m", "width_m", "height_m")
_REMEDY: Final = "download the log again"


def _schema(texts: Sequence[str], integers: Sequence[str], floats: Sequence[str]) -> pa.Schema:
    kinds = {pa.string(): texts, pa.int64(): integers, pa.float64(): floats}
    return pa.schema([pa.field(name, kind, nullable=False) for kind, names in kinds.items() for name in names])


_POSE_SCHEMA: Final = _schema((), ("timestamp_ns",), COLUMNS)
_INTRINSIC_SCHEMA: Final = _schema(
    ("sensor_name",), ("width_px", "height_px"), ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3")
)
_MOUNTING_SCHEMA: Final = _schema(("sensor_name",), (), COLUMNS)
_BOX_SCHEMA: Final = _schema(("track_uuid", "category"), ("timestamp_ns",), (*_SIZES, *COLUMNS))


class Argoverse2Reader:
    """A reader of one log of the Argoverse 2 sensor dataset."""

    name = "argoverse2"
    expects = f"a log folder of Argoverse 2 with {_POSES}"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder holds a log's poses."""
        return path.is_dir() and find_file(path, _POSES) is not None

    def open(self, path: Path, options: Mapping[str, str]) -> Argoverse2Recording:
        """Open a log.

        The option ``city`` is the city's abbreviation (``PIT``), for logs without a map.
        """
        refuse_options(options, ("city",), path, self.name)
        require_file(path, _POSES)
        city = options.get("city") or _find_city(path)
        if city is not None and city not in _CITIES:
            raise RecordingError(
                f"unknown city {city!r:.80}", file=path, place="city", expected=f"one of {', '.join(_CITIES)}"
            )
        return Argoverse2Recording(path, city)


def _find_city(path: Path) -> str | None:
    """The city in the names of a log's map files; None: the log has no map."""
    folder = path / "map"
    if not folder.is_dir():
        return None
    cities = {match[1] for name in list_folder(path, folder) if (match := _CITY_OF_MAP.search(name))}
    if len(cities) > 1:
        raise RecordingError(
            f"map files of {' and '.join(sorted(cities))}", file=folder, expected="one city", remedy=_REMEDY
        )
    return cities.pop() if cities else None


@dataclass(frozen=True)
class Argoverse2Recording:
    """One log of the Argoverse 2 sensor dataset.

    Attributes:
        path: the log's folder.
        city: the city's abbreviation; None: not known, the track is in a local frame.
    """

    path: Path
    city: str | None

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; its id is the log's id, and the dataset names no vehicle, date or weather."""
        name = to_identifier(self.path.resolve().name)
        return DriveInfo(
            drive_id=name,
            vehicle_id="argoverse2",
            vehicle_type="Ford Fusion",
            time_base="nanoseconds of a clock without a date",
            frame=None if self.city is not None else f"argoverse2_{name}"[:120],
            body_frame="rear_axle",
            is_clip=True,
            city=None if self.city is None else _CITIES[self.city].name,
            licence="CC BY-NC-SA 4.0",
            has_date=False,
        )

    @cached_property
    def _images(self) -> dict[str, dict[int, Path]]:
        """Images by camera and stamp, in order; the reference camera first."""
        folder = self.path / "sensors" / "cameras"
        if not folder.is_dir():
            return {}
        cameras = sorted(child.name for child in folder.iterdir() if child.is_dir() and not child.name.startswith("."))
        images: dict[str, dict[int, Path]] = {}
        for camera in sorted(cameras, key=lambda name: (name != _REFERENCE, name)):
            if files := self._stamped_files(folder / camera, "jpg", "image of the camera"):
                images[camera] = files
        return images

    def _stamped_files(self, folder: Path, ending: str, what: str) -> dict[int, Path]:
        """Files of a sensor by the stamp in their names, in order."""
        files: dict[int, Path] = {}
        for name, file in list_folder(self.path, folder).items():
            stem, _, suffix = name.rpartition(".")
            if suffix != ending or not stem.isdecimal() or len(stem) > 19 or int(stem) >= 2**63:
                raise RecordingError(
                    f"no {what}", file=file, expected=f"<timestamp_ns>.{ending}", remedy="move it elsewhere"
                )
            files[int(stem)] = file
        return dict(sorted(files.items()))

    @cached_property
    def rig(self) -> RigInfo | None:
        """The cameras that have images; None for a log without images."""
        cameras = tuple(
            CameraInfo(
                _CANONICAL.get(name, to_identifier(name)),
                name,
                # Stereo cameras have no calibration in one log of the dataset: they stay uncalibrated.
                is_calibrated=name in self._lenses and name in self._mountings,
            )
            for name in self._images
        )
        if not cameras:
            return None
        ring = sum(camera.source_name.startswith("ring_") for camera in cameras)
        whole = {7: "ring", 9: "all"}.get(len(cameras)) if ring == 7 else None
        rig_id = f"argoverse2_{whole}" if whole else f"argoverse2_{self.info.drive_id}"[:120]
        return RigInfo(rig_id, cameras, cameras[0].name)

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the poses, calibration, boxes and images; no sweep or map is opened."""
        names = [_POSES, *(name for name in (_INTRINSICS, _MOUNTINGS, _BOXES) if find_file(self.path, name))]
        images = [file for files in self._images.values() for file in files.values()]
        listed = [(file.relative_to(self.path).as_posix(), file) for file in images]
        return sorted([*((name, self.path / name) for name in names), *listed])

    def track(self) -> Track:
        """Return the ego's poses, on WGS 84 through the city's UTM zone."""
        file = require_file(self.path, _POSES)
        table = read_feather(file, _POSE_SCHEMA)
        stamps: Int64 = np.asarray(table.column("timestamp_ns"))
        quaternion, position = matrix_of(table, COLUMNS[:4]), matrix_of(table, COLUMNS[4:])

        faults, rotation = mark_rotations(quaternion, file=file, place="row {}".format)
        x, y, z = position.T
        if self.city is None:
            return faults.drop_from(Track(stamps, x_m=x, y_m=y, height_m=z, rotation=rotation, file=file))
        city = _CITIES[self.city]
        east, north = geodetic_to_utm([city.longitude_deg], [city.latitude_deg], city.zone, True)
        track = track_from_utm(
            stamps,
            x + east,
            y + north,
            z,
            rotation,
            zone=city.zone,
            north=True,
            faults=faults,
            locate=lambda row: (file, f"row {row}"),
            file=file,
        )
        return faults.drop_from(track)

    @cached_property
    def _lenses(self) -> dict[str, dict[str, Any]]:
        """Rows of the intrinsics by sensor."""
        rows = read_feather(require_file(self.path, _INTRINSICS), _INTRINSIC_SCHEMA).to_pylist()
        return {row["sensor_name"]: row for row in rows}

    @cached_property
    def _mountings(self) -> dict[str, Poses]:
        """``ego_SE3_sensor`` by sensor."""
        file = require_file(self.path, _MOUNTINGS)
        mounted = read_feather(file, _MOUNTING_SCHEMA)
        quaternion, position = matrix_of(mounted, COLUMNS[:4]), matrix_of(mounted, COLUMNS[4:])
        poses = require_poses(quaternion, position, file=file, place="row {}".format)
        return {name: poses[row] for row, name in enumerate(mounted.column("sensor_name").to_pylist())}

    def calibrations(self) -> pa.Table:
        """Return the undistorted cameras that have images."""
        calibrations: list[tuple[Stage, Calibration]] = []
        for name in self._images:
            if name not in self._lenses or name not in self._mountings:
                continue
            lens = self._lenses[name]
            calibration = make_calibration(
                self.path / _INTRINSICS,
                _CANONICAL.get(name, to_identifier(name)),
                model="pinhole",
                width_px=lens["width_px"],
                height_px=lens["height_px"],
                fx_px=lens["fx_px"],
                fy_px=lens["fy_px"],
                # The devkit follows OpenCV: the centre of the first pixel is at 0.
                cx_px=lens["cx_px"] + 0.5,
                cy_px=lens["cy_px"] + 0.5,
                ego_SE3_camera=to_pose_numbers(self._mountings[name]),
                method="Argoverse 2 calibration, images undistorted",
            )
            calibrations.append(("factory", calibration))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return each camera's images; a file's name is taken as mid-exposure, as exposure lengths are not recorded."""
        streams: dict[str, ImageStream] = {}
        for source, files in self._images.items():
            name = _CANONICAL.get(source, to_identifier(source))
            stamps: Int64 = np.fromiter(files, np.int64, len(files))
            streams[name] = FileStream(name, "jpeg", stamps, stamps, tuple(files.values()))
        return streams

    def lidars(self) -> Sequence[LidarSweeps]:
        """Return the sweeps, each of both lidars; their points are in the ego frame at the sweep's stamp."""
        folder = self.path / "sensors" / "lidar"
        files = self._stamped_files(folder, "feather", "sweep of the lidars") if folder.is_dir() else {}
        if not files:
            return ()
        uris = tuple(str(file.absolute()) for file in files.values())
        stamps: Int64 = np.fromiter(files, np.int64, len(files))
        return (LidarSweeps("lidar", "av2_feather", stamps, uris, Poses.identity(len(files))),)

    def boxes(self) -> pa.Table | None:
        """Return the annotations; None for a log of the test split."""
        file = find_file(self.path, _BOXES)
        if file is None:
            return None
        table = read_feather(file, _BOX_SCHEMA)
        quaternion, position = matrix_of(table, COLUMNS[:4]), matrix_of(table, COLUMNS[4:])
        ego_SE3_box = require_poses(quaternion, position, file=file, place="row {}".format)
        columns = {
            "timestamp_ns": table.column("timestamp_ns"),
            "track_id": table.column("track_uuid"),
            "category": table.column("category").cast(pa.string()),
            "source": "argoverse2",
            "source_version": "v2",
        }
        return make_box_table(ego_SE3_box, matrix_of(table, _SIZES), columns)
