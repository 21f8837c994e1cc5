"""What every recording format gives the toolkit: one protocol, read lazily.

A reader turns one format into a `Recording`. It converts its source's time base to Unix nanoseconds, its angles to
unit quaternions (scalar first), its distances to metres, and its frames to ours (docs/conventions.md); it does not
clean, filter or cut. It opens no picture until `ImageStream.read` is called, and no file before it is asked for.

A third-party package adds a format by an entry point in the group ``mirror.recordings`` that names a `Reader` class.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import pyarrow as pa

from mirror.arrays import Float64, Int64, UInt8
from mirror.errors import RecordingError
from mirror.recordings.bad_rows import BadRows
from mirror.recordings.opening import read_file

ENTRY_POINT_GROUP = "mirror.recordings"


@dataclass(frozen=True)
class DriveInfo:
    """Who recorded what, where and when.

    Attributes:
        drive_id: letters, digits, ``_`` and ``-``.
        vehicle_id: pseudonym of the vehicle, the same alphabet.
        vehicle_type: make or class of the vehicle.
        time_base: the source's own time base in words, e.g. ``GPS microseconds``; stamps given out are Unix UTC.
        frame: None if positions are WGS 84; else the name of the local metric frame they are in.
        body_frame: what the recorded poses are poses of, e.g. ``ego`` (rear axle) or ``camera``; where it is not
            ``ego`` and the offset is unknown, the ego frame is that body turned to x forward, y left, z up.
        is_clip: True if the source arrives as clips, each judged whole.
        city: city, if the source says.
        weather: ``clear``, ``clouds``, ``rain``, ``snow``, ``fog`` or None, if the source says.
        light: ``day``, ``dusk``, ``night`` or None; where None it is computed from the sun.
        licence: licence of the recording, if the source says.
    """

    drive_id: str
    vehicle_id: str
    vehicle_type: str
    time_base: str
    frame: str | None = None
    body_frame: str = "ego"
    is_clip: bool = False
    city: str | None = None
    weather: str | None = None
    light: str | None = None
    licence: str | None = None


@dataclass(frozen=True)
class Track:
    """All poses of a drive, as recorded: unsorted, repeated and wild ones included.

    Attributes:
        timestamp_ns: (N,) Unix time, UTC.
        longitude_deg: (N,) WGS 84, or None in a local metric frame.
        latitude_deg: (N,) WGS 84, or None in a local metric frame.
        x_m: (N,) in the local metric frame, or None.
        y_m: (N,) in the local metric frame, or None.
        height_m: (N,) above the ellipsoid (local frame: z), or None where the source has none.
        rotation: (N, 4) unit quaternion, scalar first: ``enu_SE3_ego`` with east-north-up at the pose's own place
            (local frame: ``frame_SE3_ego``), or None where the source has no orientation.
        sigma_m: (N,) horizontal 1-sigma of each fix, or None.
        file: the file the poses came from, for messages.
        bad: rows of the recording that make no pose and are therefore not among the N, or None.
    """

    timestamp_ns: Int64
    longitude_deg: Float64 | None = None
    latitude_deg: Float64 | None = None
    x_m: Float64 | None = None
    y_m: Float64 | None = None
    height_m: Float64 | None = None
    rotation: Float64 | None = None
    sigma_m: Float64 | None = None
    file: Path | None = None
    bad: BadRows | None = None

    def __len__(self) -> int:
        return len(self.timestamp_ns)


@dataclass(frozen=True)
class CameraInfo:
    """One camera of a rig.

    Attributes:
        name: canonical name where the rig maps to it, else the source's own.
        source_name: what the source calls it.
        static_mask: (H, W) non-zero where the vehicle itself is seen, or None.
    """

    name: str
    source_name: str
    static_mask: UInt8 | None = None


@dataclass(frozen=True)
class RigInfo:
    """The cameras of a vehicle; ``reference_camera`` defines the frames."""

    rig_id: str
    cameras: tuple[CameraInfo, ...]
    reference_camera: str


@runtime_checkable
class ImageStream(Protocol):
    """The pictures of one camera in time order; nothing is opened before `read`."""

    @property
    def camera(self) -> str:
        """The camera's name."""
        ...

    @property
    def codec(self) -> str:
        """``jpeg`` or ``png``: what `path` and `read` give; ``video``: JPEG decoded from a video, by `read` alone."""
        ...

    @property
    def exposure_start_ns(self) -> Int64:
        """(N,) start of the exposure of the first row, Unix time."""
        ...

    @property
    def exposure_end_ns(self) -> Int64:
        """(N,) end of the exposure of the last row, Unix time."""
        ...

    def path(self, index: int) -> str | Path | None:
        """The file that holds exactly this picture's encoded bytes, to be linked or copied; None: use `read`."""
        ...

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield ``(index, encoded bytes)`` for ascending indices, decoding as little as it can."""
        ...


@dataclass(frozen=True)
class FileStream:
    """One encoded picture a file."""

    camera: str
    codec: str
    exposure_start_ns: Int64
    exposure_end_ns: Int64
    paths: tuple[str | Path, ...] = field(repr=False)

    def __post_init__(self) -> None:
        if not len(self.paths) == len(self.exposure_start_ns) == len(self.exposure_end_ns):
            raise RecordingError(
                f"{len(self.paths)} pictures but {len(self.exposure_start_ns)} exposure stamps",
                place=f"camera {self.camera}",
            )

    def path(self, index: int) -> str | Path:
        """The picture's file."""
        return self.paths[index]

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield each file's bytes."""
        for index in indices:
            yield index, read_file(self.paths[index])


@dataclass(frozen=True)
class ReferencedStream:
    """Pictures that lie elsewhere, in a bucket or on a server: ingest refers to them, and opens none.

    Attributes:
        camera: the camera's name.
        codec: ``jpeg`` or ``png``.
        exposure_start_ns: (N,) as in `ImageStream`.
        exposure_end_ns: (N,) as in `ImageStream`.
        uris: absolute, one a picture, as fsspec understands them.
        byte_length: (N,) of each picture; it begins at the first byte of its uri.
        width_px: (N,) of each picture.
        height_px: (N,) of each picture.
    """

    camera: str
    codec: str
    exposure_start_ns: Int64
    exposure_end_ns: Int64
    uris: tuple[str, ...] = field(repr=False)
    byte_length: Int64 = field(repr=False)
    width_px: Int64 = field(repr=False)
    height_px: Int64 = field(repr=False)

    def __post_init__(self) -> None:
        columns = (self.exposure_start_ns, self.exposure_end_ns, self.byte_length, self.width_px, self.height_px)
        if any(len(column) != len(self.uris) for column in columns):
            raise RecordingError(
                f"{len(self.uris)} pictures but columns of {', '.join(str(len(column)) for column in columns)}",
                place=f"camera {self.camera}",
            )

    def path(self, index: int) -> None:
        """None: there is no file."""

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield each picture's bytes, fetched one after the other.

        Raises:
            RecordingError: one cannot be had.
        """
        import fsspec

        for index in indices:
            try:
                filesystem, path = fsspec.core.url_to_fs(self.uris[index])
                data = bytes(filesystem.cat_file(path, start=0, end=int(self.byte_length[index])))
            except (OSError, ImportError, ValueError) as error:
                raise RecordingError(
                    f"cannot be fetched: {error}",
                    file=self.uris[index],
                    place=f"camera {self.camera}",
                    expected="a picture that fsspec reads with the packages installed here",
                ) from error
            yield index, data


@runtime_checkable
class Recording(Protocol):
    """One drive. Every method may be called more than once; none writes anything."""

    @property
    def info(self) -> DriveInfo:
        """Who, where, when."""
        ...

    @property
    def rig(self) -> RigInfo | None:
        """The cameras; None for a poses-only recording."""
        ...

    def files(self) -> Sequence[tuple[str, Path | str]]:
        """Every file of the recording as ``(path relative to the recording, path)``, for the fingerprint."""
        ...

    def track(self) -> Track:
        """All poses. A drive in several files is given as one track."""
        ...

    def calibrations(self) -> pa.Table:
        """Rows of the ``calibrations`` table (`mirror.schema.tables.CALIBRATIONS`), all stages; may be empty."""
        ...

    def images(self) -> Mapping[str, ImageStream]:
        """Image streams by camera name; empty for a poses-only recording."""
        ...

    def boxes(self) -> pa.Table | None:
        """Rows of the ``boxes`` table (`mirror.schema.tables.BOXES`), or None where the source has none."""
        ...


@runtime_checkable
class Reader(Protocol):
    """One recording format.

    Attributes:
        name: of the entry point and of ``--reader``.
        expects: what a path of this format looks like, for messages.
    """

    name: str
    expects: str

    def recognises(self, path: Path) -> bool:
        """Whether the path looks like this format, by names alone (fast, opens at most one small file)."""
        ...

    def open(self, path: Path, options: Mapping[str, str]) -> Recording:
        """Open a recording.

        Raises:
            RecordingError: naming the file, the place, what was expected and the remedy; also for unknown options.
        """
        ...
