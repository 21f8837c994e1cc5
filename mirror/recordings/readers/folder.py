"""Reads the `folder` layout, MIRROR's own raw layout for fleet recordings; docs/recordings/folder.md specifies it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.recordings.calibration import STAGES, Calibration, Stage, to_calibration_table
from mirror.recordings.coordinates import to_ego_track, track_from_ecef, track_from_utm
from mirror.recordings.folder_document import (
    DOCUMENT_NAME,
    FolderDocument,
    read_calibrations,
    read_document,
    recording_errors,
)
from mirror.recordings.opening import find_file, require_file
from mirror.recordings.orientation import ANGLES, QUATERNION, read_orientation
from mirror.recordings.paths import list_files, list_folder, natural_key
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, RigInfo, Track
from mirror.recordings.readers.folder_images import image_stream
from mirror.recordings.registry import refuse_options
from mirror.recordings.static_masks import read_static_mask
from mirror.recordings.tabular import RecordingRows, read_rows
from mirror.recordings.time import TIME_BASES
from mirror.schema.files import conform
from mirror.schema.tables import BOXES

_TABLES: Final = (".csv", ".parquet")
_POSITIONS: Final = {
    "wgs84": ("longitude_deg", "latitude_deg", "height_m"),
    "utm": ("easting_m", "northing_m", "height_m"),
    "ecef": ("x_m", "y_m", "z_m"),
    "local": ("x_m", "y_m", "z_m"),
}
_NUMBERS: Final = {name for names in (*_POSITIONS.values(), QUATERNION, ANGLES, ("sigma_m",)) for name in names}


class FolderReader:
    """A reader of one recording in the `folder` layout."""

    name = "folder"
    expects = "a folder with recording.json"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder holds ``recording.json``."""
        return find_file(path, DOCUMENT_NAME) is not None

    def open(self, path: Path, options: Mapping[str, str]) -> FolderRecording:
        """Open a recording; there are no options, because ``recording.json`` holds all settings."""
        refuse_options(options, (), path, self.name)
        return FolderRecording(path, read_document(require_file(path, DOCUMENT_NAME)))


@dataclass(frozen=True)
class FolderRecording:
    """A drive with any number of cameras."""

    path: Path
    document: FolderDocument

    @property
    def info(self) -> DriveInfo:
        """The entries of ``recording.json``."""
        document = self.document
        return DriveInfo(
            drive_id=document.drive_id,
            vehicle_id=document.vehicle_id,
            vehicle_type=document.vehicle_type,
            time_base=TIME_BASES[document.time_base].words,
            frame=document.frame.name,
            body_frame=document.body_frame,
            is_clip=document.is_clip,
            city=document.city,
            weather=document.weather,
            light=document.light,
            licence=document.licence,
            has_date=TIME_BASES[document.time_base].has_date,
            has_poses=bool(self._found_pose_files),
        )

    @cached_property
    def rig(self) -> RigInfo | None:
        """The cameras with their masks; None if the recording has no cameras."""
        document = self.document
        if document.rig_id is None or document.reference_camera is None:
            return None
        cameras = tuple(
            CameraInfo(
                name,
                entry.source_name or name,
                read_static_mask(self.path, entry.static_mask, name, self.path / DOCUMENT_NAME),
                entry.calibrated,
            )
            for name, entry in document.cameras.items()
        )
        return RigInfo(document.rig_id, cameras, document.reference_camera)

    def files(self) -> Sequence[tuple[str, str]]:
        """Return all files of the folder except hidden files and ``truth/``, which `mirror synth` writes."""
        return [file for file in list_files(self.path) if not file[0].startswith("truth/")]

    @cached_property
    def _found_pose_files(self) -> tuple[list[Path], list[Path]] | None:
        """The files of poses in the folder itself, and in its folder ``poses``; None: there are none."""
        single = [file for suffix in _TABLES if (file := find_file(self.path, f"poses{suffix}"))]
        folder = self.path / "poses"
        parts: list[Path] = []
        if folder.is_dir():
            listed = list_folder(self.path, folder)
            parts = [listed[name] for name in sorted(listed, key=natural_key) if Path(name).suffix in _TABLES]
        return (single, parts) if single or parts else None

    @cached_property
    def _pose_files(self) -> list[Path]:
        single, parts = self._found_pose_files or ([], [])
        if len(single) + bool(parts) != 1 or len({file.suffix for file in parts}) > 1:
            names = [file.relative_to(self.path).as_posix() for file in (*single, *parts[:3])]
            raise RecordingError(
                f"poses in {', '.join(names)}" if names else "no poses",
                file=self.path,
                expected="one of poses.csv, poses.parquet, and a folder poses/ of files of one kind",
                remedy="keep one of them" if names else "add the poses; `mirror poses` finds those of a camera",
            )
        return single or parts

    @cached_property
    def _poses(self) -> RecordingRows:
        types = {name: pa.float64() for name in _NUMBERS}
        types |= {"timestamp": pa.string(), "timestamp_ns": pa.string()}
        return read_rows(self._pose_files, types=types, tolerant=True)

    def track(self) -> Track:
        """Return the ego's poses of all files, in Unix time, on WGS 84 or in the recording's local frame."""
        track = self._ego_track(self._poses)
        return self._poses.without_bad(track)

    def _ego_track(self, rows: RecordingRows) -> Track:
        """Convert each row to a pose, bad rows included."""
        document = self.document
        if "timestamp_ns" in rows:
            stamps = rows.stamps("timestamp_ns", "unix_ns")
        else:
            stamps = rows.stamps("timestamp", document.time_base)
        kind = document.frame.kind
        first, second, third = _POSITIONS[kind]
        quaternion = QUATERNION if any(name in rows for name in QUATERNION) else ()
        heading = ("heading_deg",) if any(name in rows for name in ANGLES) and not quaternion else ()
        rows.require_columns((first, second, *((third,) if kind == "ecef" else ()), *quaternion, *heading))
        across, along = rows.floats(first), rows.floats(second)
        up = rows.floats(third) if third in rows or kind == "ecef" else None
        rotation, level = read_orientation(rows)
        sigma = rows.sigmas("sigma_m") if "sigma_m" in rows else None
        file = self._pose_files[0]
        if kind == "utm":
            track = track_from_utm(
                stamps,
                across,
                along,
                up,
                rotation,
                zone=document.frame.zone or 0,
                north=document.frame.hemisphere == "north",
                faults=rows.faults,
                locate=rows.locate,
                sigma_m=sigma,
                file=file,
            )
        elif kind == "ecef":
            position = np.stack([across, along, np.asarray(up)], axis=1)
            track = track_from_ecef(
                stamps,
                position,
                None if level else rotation,
                faults=rows.faults,
                locate=rows.locate,
                sigma_m=sigma,
                file=file,
            )
            track = replace(track, rotation=rotation) if level else track
        elif kind == "local":
            track = Track(stamps, None, None, across, along, up, rotation, sigma, file)
        else:
            track = Track(stamps, across, along, None, None, up, rotation, sigma, file)
        if document.ego_SE3_body is None:
            return track
        offset = document.ego_SE3_body
        return to_ego_track(track, Poses(np.array([offset[:4]]), np.array([offset[4:]])))

    def calibrations(self) -> pa.Table:
        """Return the calibrations of all stages that have a file."""
        calibrations: list[tuple[Stage, Calibration]] = []
        for stage in STAGES:
            file = find_file(self.path, f"calibrations/{stage}.json")
            if file is None:
                continue
            for index, calibration in enumerate(read_calibrations(file)):
                if calibration.camera not in self.document.cameras:
                    raise RecordingError(
                        f"unknown camera {calibration.camera!r}",
                        file=file,
                        place=f"{index}.camera",
                        expected=f"one of {', '.join(self.document.cameras)}",
                    )
                if not self.document.cameras[calibration.camera].calibrated:
                    raise RecordingError(
                        f"recording.json declares the camera {calibration.camera!r} to have no calibration",
                        file=file,
                        place=f"{index}.camera",
                        expected="a calibration, or calibrated: false",
                        remedy=f"take the entry, or cameras.{calibration.camera}.calibrated, out",
                    )
                calibrations.append((stage, calibration))
        return to_calibration_table(calibrations, vehicle_id=self.document.vehicle_id, drive_id=self.document.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return one stream per camera."""
        return {name: image_stream(self.path, name, entry) for name, entry in self.document.cameras.items()}

    def named_images(self) -> Mapping[str, ImageStream]:
        """Return one stream per camera; files that a table of exposures names may be missing."""
        cameras = self.document.cameras.items()
        return {name: image_stream(self.path, name, entry, named=True) for name, entry in cameras}

    def boxes(self) -> pa.Table | None:
        """Return the rows of ``boxes.parquet``, cast to the `boxes` table."""
        file = find_file(self.path, "boxes.parquet")
        if file is None:
            return None
        rows = read_rows([file], types={})
        with recording_errors():
            return conform(rows.table, BOXES, file=file)
