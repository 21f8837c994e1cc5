"""Recordings whose image files are partly missing, as after a download that was not finished."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from mirror.arrays import Bool
from mirror.errors import MirrorError, RecordingError
from mirror.recordings.lidars import LidarSweeps, read_lidars
from mirror.recordings.protocol import DriveInfo, FileStream, ImageStream, Recording, RigInfo, Track


@dataclass(frozen=True)
class MissingImages:
    """The images that a recording names and whose files are missing.

    Attributes:
        count: their number.
        total: number of all images in files of their own.
        paths: their files.
    """

    count: int
    total: int
    paths: frozenset[str]

    @property
    def words(self) -> str:
        """The numbers, for messages."""
        return f"{self.count} of {self.total} images are missing"

    def to_error(self, cause: RecordingError | None = None) -> RecordingError:
        """Make the error for a drive that is refused for missing images, with the option that accepts such a drive."""
        share = math.ceil(self.count / self.total * 1000) / 1000
        remedy = cause.remedy if cause is not None and cause.remedy else "restore the images"
        problem = self.words if cause is None or cause.problem == "missing" else f"{self.words}: {cause.problem}"
        return RecordingError(
            problem,
            file=cause.file if cause is not None else min(self.paths),
            place=cause.place if cause is not None else None,
            expected=(cause.expected if cause is not None else None) or "every image that the recording names",
            remedy=f"{remedy}; or accept the drive without the missing images: --max-missing-images {share:g}",
        )


def find_missing_images(recording: Recording) -> MissingImages:
    """Look for the file of every image.

    Raises:
        RecordingError: the images cannot be listed.
    """
    total, paths = 0, []
    for stream in _named_images(recording).values():
        if isinstance(stream, FileStream):
            total += len(stream.paths)
            paths += [str(path) for path, there in zip(stream.paths, _exist(stream)) if not there]
    return MissingImages(len(paths), total, frozenset(paths))


def name_missing_images(recording: Recording, error: RecordingError) -> RecordingError:
    """Add to an error the number of missing images, and the option that accepts them."""
    try:
        missing = find_missing_images(recording)
    except MirrorError:
        return error
    return missing.to_error(error) if missing.count else error


def without_missing_images(recording: Recording, largest_share: float) -> Recording:
    """Return the recording without the images whose files are missing.

    Args:
        recording: opened.
        largest_share: of all images, that may be missing.

    Raises:
        RecordingError: more are missing.
    """
    missing = find_missing_images(recording)
    if missing.count > largest_share * missing.total:
        raise missing.to_error()
    return _Available(recording, missing) if missing.count else recording


@dataclass(frozen=True)
class _Available:
    """A recording without its missing images; all else is the recording's."""

    recording: Recording
    missing: MissingImages

    @property
    def info(self) -> DriveInfo:
        info = self.recording.info
        return replace(info, notes=(*info.notes, f"{self.missing.words}: the drive is read without them"))

    @property
    def rig(self) -> RigInfo | None:
        return self.recording.rig

    def files(self) -> Sequence[tuple[str, str | Path]]:
        listed = getattr(self.recording, "named_files", self.recording.files)()
        return [(name, path) for name, path in listed if str(path) not in self.missing.paths]

    def track(self) -> Track:
        return self.recording.track()

    def calibrations(self) -> pa.Table:
        return self.recording.calibrations()

    def images(self) -> Mapping[str, ImageStream]:
        return {name: _available(stream) for name, stream in _named_images(self.recording).items()}

    def boxes(self) -> pa.Table | None:
        return self.recording.boxes()

    def lidars(self) -> Sequence[LidarSweeps]:
        return read_lidars(self.recording)


def _named_images(recording: Recording) -> Mapping[str, ImageStream]:
    """The streams with all images that the recording names, also where `images` would refuse missing ones."""
    streams: Mapping[str, ImageStream] = getattr(recording, "named_images", recording.images)()
    return streams


def _available(stream: ImageStream) -> ImageStream:
    if not isinstance(stream, FileStream):
        return stream
    there = _exist(stream)
    return replace(
        stream,
        exposure_start_ns=stream.exposure_start_ns[there],
        exposure_end_ns=stream.exposure_end_ns[there],
        paths=tuple(path for path, exists in zip(stream.paths, there) if exists),
    )


def _exist(stream: FileStream) -> Bool:
    """(N,) whether the file of each image is there."""
    return np.array([os.path.exists(path) for path in stream.paths], np.bool_)  # noqa: PTH110
