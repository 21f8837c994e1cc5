"""comma2k19 (comma.ai): commuter drives in one-minute segments, one road camera, GNSS poses in ECEF.

A route folder ``<dongle>|<start>`` holds segments ``0, 1, 2 ...``, which are one drive. Facts of the format, checked on
the segment of the tests:

- ``frame_gps_times`` are the GPS week and the seconds of the week of every frame. ``frame_times`` are the same instants
  on the boot clock; they differ by a constant and are not needed. The receivers' own UTC is 18 s earlier, which is the
  number of leap seconds.
- ``frame_orientations`` are ``ecef_SE3_device``, scalar first, for axes forward, right, down. The velocity lies along
  +x only in this direction, which is the inverse of the one that the dataset's guide states.
- Positions are those of the camera; its mounting in the car is not recorded.
- ``video.hevc`` is a raw stream: frame n belongs to row n of the arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.quaternions import quaternion_inverse, quaternion_multiply
from mirror.recordings.calibration import Calibration, Stage, to_calibration_table
from mirror.recordings.coordinates import FLU_FROM_CAMERA, FLU_FROM_FRD, mark_invalid_rotations, track_from_ecef
from mirror.recordings.on_road import OPTION, above_road_note, put_on_road
from mirror.recordings.opening import find_file, read_array, require_file
from mirror.recordings.paths import natural_key, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, Recording, RigInfo, Track
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.time import WEEK_S, unix_from_gps_week
from mirror.recordings.video import CopiedVideo, VideoStream

# The dataset's two cars, by the id of their device.
_VEHICLES: Final = {"b0c9d2329ad1606b": "Toyota RAV4", "99c94dc769b5d96e": "Honda Civic"}
_CAMERA: Final = "front"
_FOCAL_PX: Final = 910.0
_RASTER_PX: Final = (1164, 874)
# The arrays of a segment, with their columns.
_ARRAYS: Final = {"frame_gps_times": 2, "frame_positions": 3, "frame_orientations": 4}
# The week 10,000 lies in the year 2171.
_LAST_WEEK: Final = 10_000
_POSITIONS: Final = "global_pose/frame_positions"


class Comma2k19Reader:
    """A reader of a route of comma2k19, or of one of its segments."""

    name = "comma2k19"
    expects = "a route folder of numbered segments with global_pose/frame_positions, or one such segment"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder is a segment with an array of positions, or holds such a segment."""
        return path.is_dir() and any(_has_positions(path, segment) for segment in _segments(path))

    def open(self, path: Path, options: Mapping[str, str]) -> Recording:
        """Open a route or a segment. The option ``height_m`` is the height of the camera above the road."""
        refuse_options(options, (OPTION,), path, self.name)
        segments = _segments(path) if path.is_dir() else []
        if not any(_has_positions(path, segment) for segment in segments):
            raise RecordingError("no segment", file=path, expected=self.expects)
        return put_on_road(Comma2k19Recording(path, tuple(segments)), options, path)


def _segments(path: Path) -> list[Path]:
    """The folder itself if it is a segment, else the numbered folders in it, damaged ones included."""
    if find_file(path, _POSITIONS) is not None:
        return [path]
    names = [child.name for child in path.iterdir() if child.name.isdecimal() and child.is_dir()]
    return [path / name for name in sorted(names, key=natural_key)]


def _has_positions(path: Path, segment: Path) -> bool:
    return find_file(path, (segment.relative_to(path) / _POSITIONS).as_posix()) is not None


@dataclass(frozen=True)
class _Segment:
    """The poses of one segment.

    Attributes:
        arrays: by name, one row a frame; without rows where the segment is damaged.
        error: why the segment cannot be used; None: it can.
        lost_rows: number of rows of a damaged segment.
    """

    arrays: Mapping[str, Float64]
    error: RecordingError | None = None
    lost_rows: int = 0


@dataclass(frozen=True)
class Comma2k19Recording:
    """Consecutive segments as one drive."""

    path: Path
    segments: tuple[Path, ...]

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; its id is the route's name, with the number of a single segment appended."""
        folder = self.path.resolve()
        is_segment = self.segments[0] == self.path
        route = folder.parent.name if is_segment else folder.name
        dongle = route.replace("_", "|").partition("|")[0]
        return DriveInfo(
            drive_id=to_identifier(f"{route}_{folder.name}" if is_segment else route),
            vehicle_id=to_identifier(dongle),
            vehicle_type=_VEHICLES.get(dongle, "unknown"),
            time_base="GPS week and seconds",
            body_frame="camera",
            licence="MIT",
            notes=(above_road_note("camera"),),
        )

    @property
    def rig(self) -> RigInfo | None:
        """The road camera; None if no segment has a video."""
        if not self._videos:
            return None
        return RigInfo("comma_eon", (CameraInfo(_CAMERA, "road camera"),), _CAMERA)

    @cached_property
    def _videos(self) -> dict[int, Path]:
        """Video files by the index of their segment."""
        names = [self._name(segment, "video.hevc") for segment in self.segments]
        files = {index: find_file(self.path, name) for index, name in enumerate(names)}
        return {index: file for index, file in files.items() if file is not None}

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the pose arrays and videos that exist; the car's bus and the raw GNSS are not read."""
        names = [self._name(segment, f"global_pose/{name}") for segment in self.segments for name in _ARRAYS]
        arrays = [file for name in names if (file := find_file(self.path, name)) is not None]
        return sorted((file.relative_to(self.path).as_posix(), file) for file in (*arrays, *self._videos.values()))

    @cached_property
    def _loaded(self) -> list[_Segment]:
        """The segments; a damaged one has no rows.

        Raises:
            RecordingError: every segment is damaged; this is the error of the first.
        """
        loaded = [self._load(segment) for segment in self.segments]
        errors = [segment.error for segment in loaded if segment.error is not None]
        if len(errors) == len(loaded):
            raise errors[0]
        return loaded

    def _load(self, folder: Path) -> _Segment:
        try:
            return _Segment(_load_arrays(folder, {name: self._pose_file(folder, name) for name in _ARRAYS}))
        except RecordingError as error:
            nothing = {name: np.empty((0, columns)) for name, columns in _ARRAYS.items()}
            return _Segment(nothing, error, self._count_rows(folder))

    def _count_rows(self, folder: Path) -> int:
        """Number of rows of a damaged segment, by the longest array that can be read; 1 if none can."""
        rows = 1
        for name in _ARRAYS:
            with suppress(RecordingError):
                rows = max(rows, *read_array(self._pose_file(folder, name)).shape[:1], 1)
        return rows

    def _name(self, segment: Path, name: str) -> str:
        return (segment.relative_to(self.path) / name).as_posix()

    def _pose_file(self, segment: Path, name: str) -> Path:
        return require_file(self.path, self._name(segment, f"global_pose/{name}"))

    @cached_property
    def _no_stamps(self) -> list[Bool]:
        return [~_are_stamps(segment.arrays["frame_gps_times"]) for segment in self._loaded]

    @cached_property
    def _stamps(self) -> list[Int64]:
        """Unix time of each row, by segment; any value in rows without a stamp."""
        times = [
            np.where(bad[:, None], 0.0, segment.arrays["frame_gps_times"])
            for segment, bad in zip(self._loaded, self._no_stamps)
        ]
        return [unix_from_gps_week(both[:, 0], both[:, 1]) for both in times]

    def track(self) -> Track:
        """Return the poses of the camera, rotated to x forward, y left, z up, without damaged segments."""
        times, position, orientation = (
            np.concatenate([segment.arrays[name] for segment in self._loaded]) for name in _ARRAYS
        )
        unit, bad = mark_invalid_rotations(orientation)
        starts = np.cumsum([0, *(len(stamps) for stamps in self._stamps)])
        torn = [
            (int(start), segment.error)
            for start, segment in zip(starts, self._loaded)
            if segment.error is not None
            for _ in range(segment.lost_rows)
        ]
        faults = RowFaults(len(times), torn, reason="file")
        no_stamp = np.concatenate(self._no_stamps)
        faults.add(no_stamp, "time", self._error(times, "frame_gps_times", "a GPS week and seconds"))
        faults.add(bad, "rotation", self._error(orientation, "frame_orientations", "a unit quaternion, scalar first"))
        rotation = quaternion_multiply(unit, quaternion_inverse(FLU_FROM_FRD))
        first = next(folder for folder, segment in zip(self.segments, self._loaded) if segment.error is None)
        file = first / "global_pose" / "frame_positions"
        track = track_from_ecef(np.concatenate(self._stamps), position, rotation, file=file, faults=faults)
        return faults.drop_from(track)

    def _error(self, values: Float64, array: str, expected: str) -> Callable[[int], RecordingError]:
        """Return a function from a row of all segments to its error."""
        starts = np.concatenate([[0], np.cumsum([len(stamps) for stamps in self._stamps])])

        def error(row: int) -> RecordingError:
            segment = int(np.searchsorted(starts, row, side="right")) - 1
            return RecordingError(
                f"{values[row].tolist()} is not usable",
                file=self.segments[segment] / "global_pose" / array,
                place=f"row {row - starts[segment]}",
                expected=expected,
                remedy="leave the segment out: move its folder elsewhere",
            )

        return error

    def calibrations(self) -> pa.Table:
        """Return the device's nominal camera.

        The ego frame has the camera's origin and axes x forward, y left, z up, so the mounting is a rotation alone.
        """
        calibrations: list[tuple[Stage, Calibration]] = []
        if self.rig is not None:
            width, height = _RASTER_PX
            calibration = Calibration(
                camera=_CAMERA,
                model="pinhole",
                width_px=width,
                height_px=height,
                fx_px=_FOCAL_PX,
                fy_px=_FOCAL_PX,
                cx_px=width / 2,
                cy_px=height / 2,
                ego_SE3_camera=(*FLU_FROM_CAMERA.tolist(), 0.0, 0.0, 0.0),
                method="nominal focal length of the device",
            )
            calibrations.append(("factory", calibration))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return the videos of all segments as one stream; the stamp of a frame is taken as its mid-exposure."""
        if not self._videos:
            return {}
        parts = []
        for index, file in self._videos.items():
            frames = np.flatnonzero(~self._no_stamps[index])
            stamps = self._stamps[index][frames]
            parts.append(VideoStream(_CAMERA, stamps, stamps, file, frames))
        return {_CAMERA: _SegmentedStream(tuple(parts))}

    def boxes(self) -> None:
        """Return None: the dataset has no boxes."""
        return


@dataclass(frozen=True)
class _SegmentedStream:
    """The videos of consecutive segments as one stream."""

    parts: tuple[VideoStream, ...]
    camera: str = _CAMERA
    codec: str = "video"

    @property
    def exposure_start_ns(self) -> Int64:
        return np.concatenate([part.exposure_start_ns for part in self.parts])

    @property
    def exposure_end_ns(self) -> Int64:
        return np.concatenate([part.exposure_end_ns for part in self.parts])

    def path(self, index: int) -> None:
        return

    def copy_video(self, indices: Int64, folder: Path, name: str) -> list[CopiedVideo]:
        copies: list[CopiedVideo] = []
        start = 0
        for number, part in enumerate(self.parts):
            end = start + len(part.pts)
            within = indices[(indices >= start) & (indices < end)] - start
            if len(within):
                copies += part.copy_video(within, folder, f"{name}_{number}" if copies else name)
            start = end
        return copies

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        start = 0
        for part in self.parts:
            end = start + len(part.pts)
            within = [index - start for index in indices if start <= index < end]
            for index, data in part.read(within):
                yield index + start, data
            start = end


def _load_arrays(segment: Path, files: Mapping[str, Path]) -> dict[str, Float64]:
    arrays = {}
    for name, columns in _ARRAYS.items():
        file = files[name]
        array = read_array(file)
        if array.ndim != 2 or array.shape[1] != columns or not len(array):
            raise RecordingError(f"an array of shape {array.shape}", file=file, expected=f"(N, {columns}), N > 0")
        arrays[name] = array
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise RecordingError(f"arrays of different lengths {lengths}", file=segment, expected="one row a frame in each")
    return arrays


def _are_stamps(week_and_seconds: Float64) -> Bool:
    """(N,) True where a row of (N, 2) is a GPS week (not rolled over) and seconds within the week."""
    week, seconds = week_and_seconds.T
    return (week >= 0) & (week <= _LAST_WEEK) & (seconds >= 0) & (seconds <= WEEK_S)
