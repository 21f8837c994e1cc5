"""A summary of a recording; no image is opened."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64
from mirror.recordings.lidars import read_lidars
from mirror.recordings.opening import unreadable_error
from mirror.recordings.pauses import count_missing_images
from mirror.recordings.protocol import DriveInfo, ImageStream, Recording, repeated_stamps


@dataclass(frozen=True)
class CameraSummary:
    """The images of one camera.

    Attributes:
        images: number of images.
        codec: jpeg, png or video.
        first_ns: mid-exposure of the first image; None: there is no image.
        last_ns: mid-exposure of the last image.
        rate_hz: inverse of the median step between images; None: fewer than two images.
        calibrations: number of calibration rows by stage.
        missing: number of images that are missing in the camera's pauses (`count_missing_images`).
        repeated: number of images that are left out, because another one has the same stamp.
        first_repeated_ns: stamp of the first of them; None: there is none.
        is_calibrated: False: the source states that it has no calibration of the camera.
    """

    images: int
    codec: str
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    calibrations: Mapping[str, int]
    missing: int = 0
    repeated: int = 0
    first_repeated_ns: int | None = None
    is_calibrated: bool = True


@dataclass(frozen=True)
class RecordingSummary:
    """A summary of a recording.

    Attributes:
        info: drive, vehicle, place and time base.
        files: number of files.
        bytes: total size of the files.
        poses: number of recorded fixes.
        usable: number of fixes with a finite position on the globe.
        first_ns: the earliest stamp; None: there is no usable fix.
        last_ns: the latest stamp.
        extent: smallest and largest value of each coordinate, by name.
        has: those of height_m, rotation and sigma_m that the fixes have.
        rig_id: the rig; None: the recording has only poses.
        reference_camera: the camera that defines the frames.
        cameras: summaries by camera name.
        boxes: number of 3D boxes.
        sweeps: number of lidar sweeps.
        bad_rows: number of rows that make no pose, by reason.
        first_bad_row: the error of the first of them; None: there is none.
    """

    info: DriveInfo
    files: int
    bytes: int
    poses: int
    usable: int
    first_ns: int | None
    last_ns: int | None
    extent: Mapping[str, tuple[float, float]]
    has: tuple[str, ...]
    rig_id: str | None
    reference_camera: str | None
    cameras: Mapping[str, CameraSummary]
    boxes: int
    sweeps: int = 0
    bad_rows: Mapping[str, int] = field(default_factory=dict)
    first_bad_row: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes as plain values, for ``--json``."""
        return asdict(self)


def summarise(recording: Recording) -> RecordingSummary:
    """Read a recording's poses, calibrations and image stamps.

    Raises:
        RecordingError: a part of the recording cannot be read.
    """
    track = recording.track()
    pair = {"longitude_deg": track.longitude_deg, "latitude_deg": track.latitude_deg}
    if track.longitude_deg is None:
        pair = {"x_m": track.x_m, "y_m": track.y_m}
    columns: dict[str, Float64] = {name: values for name, values in pair.items() if values is not None}
    limits = {"longitude_deg": 180.0, "latitude_deg": 90.0}
    good = np.ones(len(track), np.bool_)
    for name, values in columns.items():
        good &= np.isfinite(values) & (np.abs(values) <= limits.get(name, np.inf))
    stamps = track.timestamp_ns[good]
    files = [_file_size(Path(path)) for _, path in recording.files()]
    boxes = recording.boxes()
    rig = recording.rig
    calibrations = recording.calibrations()
    stages = [calibrations.column(name).cast(pa.string()).to_pylist() for name in ("camera", "stage")]
    rows = Counter(zip(*stages))
    streams = recording.images()
    without = {camera.name for camera in rig.cameras if not camera.is_calibrated} if rig else set()
    names = dict.fromkeys([*(camera.name for camera in rig.cameras), *streams] if rig else streams)
    return RecordingSummary(
        info=recording.info,
        files=len(files),
        bytes=sum(files),
        poses=len(track) + (len(track.bad) if track.bad else 0),
        usable=int(good.sum()),
        first_ns=int(stamps.min()) if len(stamps) else None,
        last_ns=int(stamps.max()) if len(stamps) else None,
        extent={name: (float(v[good].min()), float(v[good].max())) for name, v in columns.items() if len(stamps)},
        has=tuple(name for name in ("height_m", "rotation", "sigma_m") if getattr(track, name) is not None),
        rig_id=rig.rig_id if rig else None,
        reference_camera=rig.reference_camera if rig else None,
        cameras={
            name: _summarise_camera(
                streams.get(name), {s: n for (c, s), n in rows.items() if c == name}, is_calibrated=name not in without
            )
            for name in names
        },
        boxes=0 if boxes is None else boxes.num_rows,
        sweeps=sum(len(one) for one in read_lidars(recording)),
        bad_rows=track.bad.counts() if track.bad else {},
        first_bad_row=str(track.bad.first) if track.bad else None,
    )


def _file_size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError as error:
        raise unreadable_error(file, error) from error


def _summarise_camera(
    stream: ImageStream | None, calibrations: Mapping[str, int], *, is_calibrated: bool
) -> CameraSummary:
    if stream is None or not len(stream.exposure_start_ns):
        codec = "" if stream is None else stream.codec
        return CameraSummary(0, codec, None, None, None, calibrations, is_calibrated=is_calibrated)
    middle = stream.exposure_start_ns + (stream.exposure_end_ns - stream.exposure_start_ns) // 2
    steps, repeated = np.diff(middle), repeated_stamps(stream)
    period_s = float(np.median(steps)) * 1e-9 if len(steps) else 0.0
    return CameraSummary(
        images=len(middle),
        codec=stream.codec,
        first_ns=int(middle[0]),
        last_ns=int(middle[-1]),
        rate_hz=1.0 / period_s if period_s > 0 else None,
        calibrations=calibrations,
        missing=count_missing_images(middle),
        repeated=len(repeated),
        first_repeated_ns=int(repeated[0]) if len(repeated) else None,
        is_calibrated=is_calibrated,
    )
