"""What a recording holds, in brief; no picture is opened."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64
from mirror.recordings.opening import unreadable_error
from mirror.recordings.pauses import count_missing_images
from mirror.recordings.protocol import DriveInfo, ImageStream, Recording


@dataclass(frozen=True)
class CameraSummary:
    """One camera's pictures.

    Attributes:
        images: their number.
        codec: jpeg, png or video.
        first_ns: mid-exposure of the first; None: there is none.
        last_ns: of the last.
        rate_hz: pictures a second in the median; None: fewer than two.
        calibrations: rows by stage.
        missing: images that are missing in the camera's pauses (`count_missing_images`).
    """

    images: int
    codec: str
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    calibrations: Mapping[str, int]
    missing: int = 0


@dataclass(frozen=True)
class RecordingSummary:
    """A recording in brief.

    Attributes:
        info: who, where, when.
        files: number of files.
        bytes: their size.
        poses: rows of fixes as recorded.
        usable: those that make a pose, finite and on the globe.
        first_ns: the earliest stamp; None: there is no usable fix.
        last_ns: the latest stamp.
        extent: smallest and largest of each coordinate, by name.
        has: which of height, rotation and sigma_m the fixes have.
        rig_id: None: poses only.
        reference_camera: defines the frames.
        cameras: by name.
        boxes: number of 3D boxes.
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

    def to_dict(self) -> dict[str, Any]:
        """Everything, for ``--json``."""
        return asdict(self)


def summarise(recording: Recording) -> RecordingSummary:
    """Read a recording's poses, calibrations and picture stamps.

    Raises:
        RecordingError: something in it cannot be read.
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
        cameras={name: _camera(streams.get(name), {s: n for (c, s), n in rows.items() if c == name}) for name in names},
        boxes=0 if boxes is None else boxes.num_rows,
    )


def _file_size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError as error:
        raise unreadable_error(file, error) from error


def _camera(stream: ImageStream | None, calibrations: Mapping[str, int]) -> CameraSummary:
    if stream is None or not len(stream.exposure_start_ns):
        return CameraSummary(0, "" if stream is None else stream.codec, None, None, None, calibrations)
    middle = stream.exposure_start_ns + (stream.exposure_end_ns - stream.exposure_start_ns) // 2
    steps = np.diff(middle)
    period_s = float(np.median(steps)) * 1e-9 if len(steps) else 0.0
    return CameraSummary(
        images=len(middle),
        codec=stream.codec,
        first_ns=int(middle[0]),
        last_ns=int(middle[-1]),
        rate_hz=1.0 / period_s if period_s > 0 else None,
        calibrations=calibrations,
        missing=count_missing_images(middle),
    )
