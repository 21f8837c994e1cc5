"""Writes a recording in the `folder` layout from another recording: chosen images, and new poses and calibrations."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from mirror.arrays import Int64
from mirror.recordings.assembly.assemble import EXPOSURES, encode_poses, encode_rows, place_file, unfinished_folder
from mirror.recordings.calibration import STAGES, Calibration, Stage
from mirror.recordings.folder_document import DOCUMENT_NAME
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, RigInfo, Track
from mirror.schema.files import write_bytes

_SUFFIXES: Final = {"png": ".png", "jpeg": ".jpg", "video": ".jpg"}


@dataclass(frozen=True)
class DerivedRecording:
    """The contents of a new recording.

    Attributes:
        info: the drive; its frame is that of the track.
        rig: the cameras; those without images are left out.
        track: the poses of the ego frame.
        streams: images of the source, by camera.
        indices: (N,) ascending images of each camera to take, by camera.
        calibrations: pairs of a stage and a calibration.
        boxes: rows of the `boxes` table; None: there are none.
        documents: further files, by name.
    """

    info: DriveInfo
    rig: RigInfo
    track: Track
    streams: Mapping[str, ImageStream]
    indices: Mapping[str, Int64]
    calibrations: Sequence[tuple[Stage, Calibration]]
    boxes: pa.Table | None
    documents: Mapping[str, bytes]


def write_derived(out: Path, made: DerivedRecording) -> None:
    """Write a recording, which gets its name only when it is complete. Files of images are linked where possible.

    Args:
        out: folder of the recording, absent or empty.
        made: the contents.

    Raises:
        DatasetError: a file cannot be written.
        RecordingError: an image cannot be read.
    """
    import pyarrow.parquet as pq

    cameras = [camera for camera in made.rig.cameras if len(made.indices.get(camera.name, ()))]
    calibrated = {calibration.camera for _, calibration in made.calibrations}
    with unfinished_folder(out) as folder:
        for camera in cameras:
            _write_images(folder, made.streams[camera.name], made.indices[camera.name])
        entries = {camera.name: _entry(folder, camera, camera.name in calibrated) for camera in cameras}
        write_bytes(folder / "poses.csv", encode_poses(made.track))
        for stage in STAGES:
            own = [one.model_dump(mode="json") for kind, one in made.calibrations if kind == stage]
            if own:
                (folder / "calibrations").mkdir(exist_ok=True)
                write_bytes(folder / "calibrations" / f"{stage}.json", (json.dumps(own, indent=2) + "\n").encode())
        if made.boxes is not None:
            pq.write_table(made.boxes, folder / "boxes.parquet")
        for name, data in made.documents.items():
            write_bytes(folder / name, data)
        document = _document(made, entries)
        write_bytes(folder / DOCUMENT_NAME, (json.dumps(document, indent=2) + "\n").encode())


def _document(made: DerivedRecording, cameras: Mapping[str, Any]) -> dict[str, Any]:
    info = made.info
    document: dict[str, Any] = {
        "format": "mirror-folder",
        "version": "1.0",
        "drive_id": info.drive_id,
        "vehicle_id": info.vehicle_id,
        "vehicle_type": info.vehicle_type,
        "rig_id": made.rig.rig_id,
        "time_base": "unix_ns" if info.has_date else "clock_ns",
        "frame": {"kind": "wgs84"} if info.frame is None else {"kind": "local", "name": info.frame},
        "is_clip": info.is_clip,
        "reference_camera": made.rig.reference_camera if made.rig.reference_camera in cameras else next(iter(cameras)),
        "cameras": cameras,
    }
    others = {"city": info.city, "licence": info.licence, "weather": info.weather, "light": info.light}
    return document | {key: value for key, value in others.items() if value is not None}


def _entry(folder: Path, camera: CameraInfo, is_calibrated: bool) -> dict[str, Any]:
    """Write the mask of a camera, and return its entry in ``recording.json``."""
    import cv2

    entry: dict[str, Any] = {}
    if camera.source_name != camera.name:
        entry["source_name"] = camera.source_name
    if camera.static_mask is not None:
        (folder / "masks").mkdir(exist_ok=True)
        entry["static_mask"] = f"masks/{camera.name}.png"
        write_bytes(folder / entry["static_mask"], cv2.imencode(".png", camera.static_mask)[1].tobytes())
    return entry if is_calibrated else entry | {"calibrated": False}


def _write_images(out: Path, stream: ImageStream, indices: Int64) -> None:
    """Link or write the images of a camera, and write its table of exposures."""
    folder = out / "images" / stream.camera
    folder.mkdir(parents=True)
    start, end = stream.exposure_start_ns[indices], stream.exposure_end_ns[indices]
    names = []
    unlinked = []
    for index, first, last in zip(indices.tolist(), start.tolist(), end.tolist()):
        path = stream.path(index)
        suffix = _SUFFIXES[stream.codec] if path is None else Path(path).suffix.lower()
        names.append(f"{first + (last - first) // 2}{suffix}")
        if path is None:
            unlinked.append(index)
        else:
            place_file(Path(path), folder / names[-1])
    by_index = dict(zip(indices.tolist(), names))
    for index, data in stream.read(unlinked):
        write_bytes(folder / by_index[index], data)
    rows = zip(names, start.tolist(), end.tolist())
    write_bytes(out / "images" / f"{stream.camera}.csv", encode_rows(("file", *EXPOSURES), rows))
