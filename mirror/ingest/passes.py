"""One drive judged: its track cleaned and held against the ROIs. Poses are read, no image is opened."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import pyarrow as pa

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.ingest.clean import CleanTrack
from mirror.ingest.fix_status import RESTART
from mirror.ingest.rois import refuse_swapped_coordinates
from mirror.ingest.trigger import Pass, RoiTrigger
from mirror.ingest.usable import clean_usable
from mirror.recordings.boundary import reader_errors
from mirror.recordings.lidars import LidarSweeps, read_lidars
from mirror.recordings.protocol import DriveInfo, ImageStream, Recording, Track
from mirror.schema.documents import CleaningOptions, CleaningReport, RecordingSource, Roi

POSE_MARGIN_NS = 1_000_000_000


@dataclass(frozen=True)
class PoseSlice:
    """The cleaned poses of one pass, from 1 s before its entry to 1 s after its exit.

    Attributes:
        timestamp_ns: (N,) strictly increasing.
        first: (N,) longitude or x.
        second: (N,) latitude or y.
        height_m: (N,) or None.
        rotation: (N, 4) as recorded, or None.
        sigma_m: (N,) or None.
        unknown: (N,) whether the motion from the pose before is not known: a gap over ``max_gap_s``, or a new track.
    """

    timestamp_ns: Int64
    lon_or_x: Float64
    lat_or_y: Float64
    height_m: Float64 | None
    rotation: Float64 | None
    sigma_m: Float64 | None
    unknown: Bool

    def poses_known(self, stamps_ns: Int64) -> Bool:
        """Mark which of (M,) stamps have a known vehicle pose: at poses, and between poses without a gap."""
        after = np.searchsorted(self.timestamp_ns, stamps_ns, side="left")
        inside = (stamps_ns >= self.timestamp_ns[0]) & (stamps_ns <= self.timestamp_ns[-1])
        after = np.minimum(after, len(self.timestamp_ns) - 1)
        return inside & ((self.timestamp_ns[after] == stamps_ns) | ~self.unknown[after])


class DriveContent:
    """Images, calibrations, boxes and sweeps of a drive, read once, when the first traversal asks for them."""

    def __init__(self, recording: Recording, path: Path) -> None:
        self._recording = recording
        self._path = path
        self._lock = Lock()
        self._read: dict[str, Any] = {}

    def images(self) -> dict[str, ImageStream]:
        """Return image streams by camera."""
        streams: dict[str, ImageStream] = self._once("images", lambda: dict(self._recording.images()))
        return streams

    def calibrations(self) -> pa.Table:
        """Return the calibration rows."""
        return self._once("calibrations", self._recording.calibrations)

    def boxes(self) -> pa.Table | None:
        """Return the box rows, or None."""
        return self._once("boxes", self._recording.boxes)

    def lidars(self) -> Sequence[LidarSweeps]:
        """Return the lidar sweeps by sensor; empty where the source has none."""
        sweeps: Sequence[LidarSweeps] = self._once("lidars", lambda: read_lidars(self._recording))
        return sweeps

    def _once(self, name: str, read: Any) -> Any:
        with self._lock:
            if name not in self._read:
                with reader_errors(self._path):
                    self._read[name] = read()
            return self._read[name]


@dataclass(frozen=True)
class DrivePasses:
    """A drive after the trigger.

    Attributes:
        path: where the recording lies.
        recording: it.
        info: who, where, when.
        source: its files and fingerprint.
        cleaning: what cleaning did.
        start_ns: first cleaned pose.
        end_ns: last cleaned pose.
        passes: accepted and refused.
        slices: the poses of each accepted pass, by its number in ``passes``.
    """

    path: Path
    recording: Recording
    info: DriveInfo
    source: RecordingSource
    cleaning: CleaningReport
    start_ns: int
    end_ns: int
    passes: tuple[Pass, ...]
    slices: dict[int, PoseSlice]

    @cached_property
    def content(self) -> DriveContent:
        """Images, calibrations and boxes of the drive, read on first use."""
        return DriveContent(self.recording, self.path)


def fingerprint(recording: Recording, reader: str, name: str) -> RecordingSource:
    """Identify a recording by the paths, sizes and modification times of its files.

    Raises:
        RecordingError: a file is not there, or there is none.
    """
    digest = hashlib.sha256()
    files, total = 0, 0
    for relative, path in sorted(recording.files()):
        try:
            status = os.stat(path)  # noqa: PTH116
        except OSError as error:
            raise RecordingError(
                f"cannot be read: {error.strerror}",
                file=path,
                remedy="make the file readable, or take it out of the recording",
            ) from error
        digest.update(f"{relative}\0{status.st_size}\0{status.st_mtime_ns}\n".encode())
        files += 1
        total += status.st_size
    if not files:
        raise RecordingError(
            "the recording is empty",
            file=name,
            expected="at least a file of poses",
            remedy="copy the recording again, or leave it out",
        )
    return RecordingSource(reader=reader, name=name, files=files, bytes=total, fingerprint=digest.hexdigest())


def find_drive_passes(
    path: Path,
    recording: Recording,
    source: RecordingSource,
    trigger: RoiTrigger,
    rois: Sequence[Roi],
    cleaning: CleaningOptions,
) -> DrivePasses:
    """Clean a drive's track and find its passes.

    Args:
        path: where the recording lies, for messages.
        recording: the drive.
        source: its fingerprint.
        trigger: made of ``rois``.
        rois: for the check of exchanged coordinates.
        cleaning: thresholds.

    Raises:
        RecordingError: the track is empty, unusable or runs backward where that is refused.
        UsageError: a ROI's longitude and latitude look exchanged.
    """
    with reader_errors(path):
        info = recording.info
        recorded = recording.track()
        track, cleaned, report = clean_usable(
            recorded, cleaning, trigger.options, is_clip=info.is_clip, has_motion=info.has_motion
        )
        kept = cleaned.kept()
    if cleaned.geodetic:
        middle = kept[len(kept) // 2]
        refuse_swapped_coordinates(rois, float(cleaned.lon_or_x[middle]), float(cleaned.lat_or_y[middle]))
    max_gap_ns = round(trigger.options.max_gap_s * 1e9)
    with reader_errors(path):
        passes = trigger.passes(cleaned, frame=info.frame, is_clip=info.is_clip)
        slices = {
            number: _slice(track, cleaned, kept, one, max_gap_ns) for number, one in enumerate(passes) if one.accepted
        }
    return DrivePasses(
        path=path,
        recording=recording,
        info=info,
        source=source,
        cleaning=report,
        start_ns=int(cleaned.timestamp_ns[kept[0]]),
        end_ns=int(cleaned.timestamp_ns[kept[-1]]),
        passes=tuple(passes),
        slices=slices,
    )


def _slice(track: Track, cleaned: CleanTrack, kept: Int64, one: Pass, max_gap_ns: int) -> PoseSlice:
    """The poses of a pass with its margins: at least the fix before and after it, unless there is a gap."""
    entry_ns, exit_ns = one.entry_ns, one.exit_ns
    stamps = cleaned.timestamp_ns[kept]
    low = int(np.searchsorted(stamps, entry_ns - POSE_MARGIN_NS, side="left"))
    high = int(np.searchsorted(stamps, exit_ns + POSE_MARGIN_NS, side="right"))
    before = max(int(np.searchsorted(stamps, entry_ns, side="right")) - 1, 0)
    after = min(int(np.searchsorted(stamps, exit_ns, side="left")), len(stamps) - 1)
    low, high = min(low, before), max(high, after + 1)
    # A margin never reaches across a gap or a restart: what was driven there is not known.
    start = low
    unknown = np.diff(stamps[low:high], prepend=stamps[low]) > max_gap_ns
    unknown |= cleaned.status[kept[low:high]] == RESTART
    cuts = low + 1 + np.flatnonzero(unknown[1:])
    inside_low = int(np.searchsorted(stamps, entry_ns, side="left"))
    inside_high = int(np.searchsorted(stamps, exit_ns, side="right"))
    low = max([low, *cuts[cuts <= inside_low].tolist()])
    high = min([high, *cuts[cuts >= max(inside_high, low + 1)].tolist()])
    positions = kept[low:high]
    rows = cleaned.recorded(positions)
    return PoseSlice(
        timestamp_ns=cleaned.timestamp_ns[positions],
        lon_or_x=cleaned.lon_or_x[positions],
        lat_or_y=cleaned.lat_or_y[positions],
        height_m=None if track.height_m is None else track.height_m[rows],
        rotation=None if track.rotation is None else track.rotation[rows],
        sigma_m=None if track.sigma_m is None else track.sigma_m[rows],
        unknown=unknown[low - start : high - start],
    )
