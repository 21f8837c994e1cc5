"""Writes a recording in the `folder` layout from a track and the images or videos of cameras.

Images and videos get a hard link where the file system allows it, else they are copied: nothing is decoded or encoded.
"""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from mirror.errors import MirrorError, RecordingError
from mirror.recordings.assembly.cameras import GivenCamera, PreparedCamera, prepare_camera
from mirror.recordings.assembly.track_notes import describe_track
from mirror.recordings.calibration import to_calibration
from mirror.recordings.folder_document import DOCUMENT_NAME
from mirror.recordings.folder_lens import write_calibrations
from mirror.recordings.orientation import QUATERNION
from mirror.recordings.protocol import DriveInfo, Recording, Track, choose_reference_camera
from mirror.recordings.time import SECOND_NS
from mirror.schema.documents import is_identifier
from mirror.schema.files import TEMPORARY, unwritable_error, write_bytes

_Item = TypeVar("_Item")
EXPOSURES: Final = ("exposure_start_ns", "exposure_end_ns")


@dataclass(frozen=True)
class DriveNames:
    """Ids of the new recording; by default the ids of the track, and ``rig_<vehicle>``.

    Attributes:
        drive_id: the drive.
        vehicle_id: pseudonym of the vehicle.
        vehicle_type: make or class of the vehicle.
        rig_id: the same for all vehicles with these cameras at these mountings.
        reference_camera: its exposures define the frames; None: ``front_wide`` if there is one, else the first camera.
        licence: licence of the recording.
        city: the city.
    """

    drive_id: str | None = None
    vehicle_id: str | None = None
    vehicle_type: str | None = None
    rig_id: str | None = None
    reference_camera: str | None = None
    licence: str | None = None
    city: str | None = None


@dataclass(frozen=True)
class Assembly:
    """A recording that was written.

    Attributes:
        poses: number of poses.
        images: number of images of each camera, by name.
        notes: what the inputs cannot give, and choices that were made, in words.
    """

    poses: int
    images: dict[str, int]
    notes: tuple[str, ...]


def assemble_recording(
    out: Path, poses: Recording | None, cameras: Sequence[GivenCamera], names: DriveNames, tz: str | None = None
) -> Assembly:
    """Write a recording, which gets its name only when it is complete.

    Args:
        out: folder of the recording, absent or empty.
        poses: any recording, whose track is taken; None: the new recording has no poses, and `names` states a drive id.
        cameras: the cameras, one of which at least.
        names: ids.
        tz: IANA zone of times without an offset.

    Raises:
        RecordingError: an input is missing or damaged, or inputs do not fit together; all faults are named.
        DatasetError: a file cannot be written.
    """
    track, prepared = _prepare(poses, cameras, names, tz)
    document = _document(_drive_info(poses, names), prepared, names)
    notes = [] if poses is None or track is None else [*poses.info.notes, *describe_track(track)]
    for camera in prepared:
        notes += _describe_camera(camera, track)
    with unfinished_folder(out) as unfinished:
        copied = _write(unfinished, track, prepared, document)
    if copied:
        notes.append(f"{copied} files were copied, because links to another file system are not possible")
    return Assembly(
        0 if track is None else len(track), {camera.name: len(camera.keys) for camera in prepared}, tuple(notes)
    )


@contextmanager
def unfinished_folder(out: Path) -> Iterator[Path]:
    """Make a folder beside ``out`` that gets its name in the end; after an error it is removed.

    Args:
        out: absent, or an empty folder.

    Raises:
        DatasetError: a file cannot be written.
    """
    unfinished = out.absolute().with_name(f".{out.absolute().name}.{os.getpid()}{TEMPORARY}")
    try:
        unfinished.mkdir(parents=True)
        yield unfinished
        if out.is_dir():
            out.rmdir()
        unfinished.replace(out)
    except OSError as error:
        raise unwritable_error(out, error) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _write(out: Path, track: Track | None, cameras: Sequence[PreparedCamera], document: Mapping[str, Any]) -> int:
    """Write all files of a recording; the number of files that were copied."""
    copied = sum(_place_camera(out, camera) for camera in cameras)
    if track is not None:
        write_bytes(out / "poses.csv", encode_poses(track))
    calibrations = [
        to_calibration(camera.name, camera.lens, camera.mounting, "lens file", time_offset_ns=camera.offset_ns)
        for camera in cameras
        if camera.lens is not None and camera.mounting is not None
    ]
    if calibrations:
        write_calibrations(out, calibrations)
    write_bytes(out / DOCUMENT_NAME, (json.dumps(document, indent=2) + "\n").encode())
    return copied


def _prepare(
    poses: Recording | None, cameras: Sequence[GivenCamera], names: DriveNames, tz: str | None
) -> tuple[Track | None, list[PreparedCamera]]:
    """Read everything; all faults are collected before one error names them."""
    faults: list[MirrorError] = []

    def attempt(read: Callable[[], _Item]) -> _Item | None:
        try:
            return read()
        except MirrorError as error:
            faults.append(error)
            return None

    track = None if poses is None else attempt(poses.track)
    prepared = [attempt(lambda camera=camera: prepare_camera(camera, tz)) for camera in cameras]  # type: ignore[misc]
    if not cameras:
        faults.append(RecordingError("no camera", place="--camera", remedy="add --camera NAME=FOLDER or NAME=VIDEO"))
    repeated = sorted({camera.name for camera in cameras if [one.name for one in cameras].count(camera.name) > 1})
    for name in repeated:
        faults.append(RecordingError(f"camera {name!r} is given twice", place="--camera", expected="each name once"))
    stated = [("--camera", camera.name) for camera in cameras]
    stated += [
        (f"--{key.replace('_', '-')}", getattr(names, key) or "x") for key in ("drive_id", "vehicle_id", "rig_id")
    ]
    for place, name in stated:
        if not is_identifier(name):
            faults.append(RecordingError(f"{name!r} is no id", place=place, expected="letters, digits, _ and -"))
    if names.reference_camera is not None and names.reference_camera not in {camera.name for camera in cameras}:
        faults.append(
            RecordingError(f"there is no camera {names.reference_camera!r}", place="--reference-camera",
                           expected=f"one of {', '.join(camera.name for camera in cameras)}")
        )  # fmt: skip
    ready = [camera for camera in prepared if camera is not None]
    if track is not None and not len(track):
        faults.append(RecordingError("the track has no poses", file=track.file, expected="poses"))
    elif track is not None:
        for camera in ready:
            attempt(lambda camera=camera: _require_overlap(camera, track))  # type: ignore[misc]
    if len(faults) == 1:
        raise faults[0]
    if faults:
        listed = "".join(f"\n  {number}. {fault}" for number, fault in enumerate(faults, 1))
        raise RecordingError(f"{len(faults)} faults:{listed}")
    return track, ready


def _require_overlap(camera: PreparedCamera, track: Track) -> None:
    """Refuse a camera of which no image was taken during the track: a clock or a time zone is wrong."""
    first, last = int(track.timestamp_ns.min()), int(track.timestamp_ns.max())
    if len(camera.start_ns) and not _inside(camera, track):
        after = int(camera.start_ns[0]) - first
        raise RecordingError(
            f"no image was taken during the track: they begin {abs(after) / SECOND_NS:,.1f} s"
            f" {'after' if after > 0 else 'before'} its first pose ({_utc(int(camera.start_ns[0]))}, {_utc(first)}),"
            f" the track takes {(last - first) / SECOND_NS:,.1f} s",
            file=camera.path, place=f"camera {camera.name}", expected="clocks that agree",
            remedy=f"check --tz (whole hours), or shift the camera: --time-offset-s {camera.name}=SECONDS",
        )  # fmt: skip


def _inside(camera: PreparedCamera, track: Track) -> int:
    """Number of images between the first and the last pose."""
    middle = camera.start_ns + (camera.end_ns - camera.start_ns) // 2
    return int(np.count_nonzero((middle >= track.timestamp_ns.min()) & (middle <= track.timestamp_ns.max())))


def _utc(stamp_ns: int) -> str:
    return f"{np.datetime64(stamp_ns, 'ns').astype('datetime64[ms]')} UTC"


def _describe_camera(camera: PreparedCamera, track: Track | None) -> list[str]:
    count = len(camera.keys)
    inside = count if track is None else _inside(camera, track)
    notes = [f"camera {camera.name}: times from {camera.source}"]
    if inside < count:
        notes.append(f"camera {camera.name}: {count - inside} of {count} images lie before or after the track")
    if camera.lens is None:
        notes.append(
            f"camera {camera.name}: no lens, declared as uncalibrated; `mirror calibrate intrinsics` finds one (--lens)"
        )
    return notes


def _drive_info(poses: Recording | None, names: DriveNames) -> DriveInfo:
    """Return what the recording of the poses says of the drive; without it the names, and a frame of its own."""
    if poses is not None:
        return poses.info
    drive = names.drive_id or "drive"
    return DriveInfo(drive, "unknown", "unknown", "unix_ns", frame=drive)


def _document(info: DriveInfo, cameras: Sequence[PreparedCamera], names: DriveNames) -> dict[str, Any]:
    vehicle = names.vehicle_id or info.vehicle_id
    reference = names.reference_camera or choose_reference_camera([camera.name for camera in cameras])
    document: dict[str, Any] = {
        "format": "mirror-folder",
        "version": "1.0",
        "drive_id": names.drive_id or info.drive_id,
        "vehicle_id": vehicle,
        "vehicle_type": names.vehicle_type or info.vehicle_type,
        "rig_id": names.rig_id or f"rig_{vehicle}",
        "time_base": "unix_ns" if info.has_date else "clock_ns",
        "frame": {"kind": "wgs84"} if info.frame is None else {"kind": "local", "name": info.frame},
        "body_frame": info.body_frame,
        "is_clip": info.is_clip,
        "reference_camera": reference,
        "cameras": {camera.name: _entry(camera) for camera in cameras},
    }
    others = {"city": names.city or info.city, "licence": names.licence or info.licence, "weather": info.weather,
              "light": info.light}  # fmt: skip
    return document | {key: value for key, value in others.items() if value is not None}


def _entry(camera: PreparedCamera) -> dict[str, Any]:
    """Return the entry of a camera in ``recording.json``."""
    masked = {"static_mask": _mask_name(camera)} if camera.static_mask is not None else {}
    return masked | ({} if camera.lens else {"calibrated": False})


def _mask_name(camera: PreparedCamera) -> str:
    return f"masks/{camera.name}.png"


def _place_camera(out: Path, camera: PreparedCamera) -> int:
    """Link or copy the files of a camera, and write its table of exposures; the number of copied files."""
    if camera.is_video:
        target = out / "videos" / f"{camera.name}{camera.path.suffix.lower()}"
        target.parent.mkdir(exist_ok=True)
        copied = int(place_file(camera.path, target))
        table, key = target.with_suffix(".csv"), "pts"
    else:
        folder = out / "images" / camera.name
        folder.mkdir(parents=True, exist_ok=True)
        copied = sum(place_file(camera.path / name, folder / name) for name in camera.keys)
        table, key = out / "images" / f"{camera.name}.csv", "file"
    if camera.static_mask is not None:
        mask = out / _mask_name(camera)
        mask.parent.mkdir(exist_ok=True)
        copied += int(place_file(camera.static_mask, mask))
    rows = zip(camera.keys, camera.start_ns.tolist(), camera.end_ns.tolist())
    write_bytes(table, encode_rows((key, *EXPOSURES), rows))
    return copied


def place_file(source: Path, target: Path) -> bool:
    """Link a file, or copy it where that is not possible; True: it was copied."""
    try:
        os.link(source.resolve(), target)
    except OSError:
        # Another file system, or one without links.
        temporary = target.with_name(f".{target.name}.part")
        shutil.copyfile(source, temporary)
        temporary.replace(target)
        return True
    return False


def encode_poses(track: Track) -> bytes:
    """Return ``poses.csv`` of a track."""
    columns: dict[str, Any] = {"timestamp_ns": track.timestamp_ns.tolist()}
    if track.longitude_deg is not None and track.latitude_deg is not None:
        columns |= {"longitude_deg": track.longitude_deg, "latitude_deg": track.latitude_deg}
        height = "height_m"
    else:
        columns |= {"x_m": track.x_m, "y_m": track.y_m}
        height = "z_m"
    if track.height_m is not None:
        columns[height] = track.height_m
    if track.rotation is not None:
        columns |= {name: track.rotation[:, axis] for axis, name in enumerate(QUATERNION)}
    if track.sigma_m is not None:
        columns["sigma_m"] = track.sigma_m
    cells = [
        values if name == "timestamp_ns" else ["" if np.isnan(value) else repr(float(value)) for value in values]
        for name, values in columns.items()
    ]
    return encode_rows(tuple(columns), zip(*cells))


def encode_rows(header: Sequence[str], rows: Any) -> bytes:
    """Return a CSV file."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue().encode()
