"""The protocol of recordings, which every recording format follows; recordings are read lazily.

A reader turns one format into a `Recording`. It converts its source's time base to Unix nanoseconds, its angles to
unit quaternions (scalar first), its distances to metres, and its frames to MIRROR's (docs/conventions.md); it does not
clean, filter or cut. It opens no image until `ImageStream.read` is called, and no file before it is needed.

A third-party package adds a format by an entry point in the group ``mirror.recordings`` that names a `Reader` class.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64, UInt8
from mirror.errors import RecordingError
from mirror.recordings.bad_rows import BadRows
from mirror.recordings.opening import read_file

ENTRY_POINT_GROUP = "mirror.recordings"


@dataclass(frozen=True)
class DriveInfo:
    """The drive, the vehicle, and how time and positions were recorded.

    Attributes:
        drive_id: letters, digits, ``_`` and ``-``.
        vehicle_id: pseudonym of the vehicle, the same alphabet.
        vehicle_type: make or class of the vehicle.
        time_base: the source's own time base in words, e.g. ``GPS microseconds``; the reader's stamps are Unix UTC.
        frame: None if positions are WGS 84; else the name of their local metric frame.
        body_frame: the body of the recorded poses, e.g. ``ego`` (rear axle) or ``camera``. If it is not ``ego`` and
            its offset is unknown, the ego frame has the body's origin and axes x forward, y left, z up.
        is_clip: True if the source arrives as clips, each judged as a whole.
        city: the city; None: the source does not state it.
        weather: ``clear``, ``clouds``, ``rain``, ``snow`` or ``fog``; None: the source does not state it.
        light: ``day``, ``dusk`` or ``night``; None: it is computed from the sun.
        licence: licence of the recording; None: the source does not state it.
        has_date: False: the stamps count from an arbitrary date, so the sun at that date says nothing about the light.
        has_motion: False: the stamps only number the poses, as those of unordered photos: no speed follows from them.
        has_poses: False: the recording has images and no poses yet; `mirror poses` finds them.
        notes: choices that the reader made where the source left one open, in words; `mirror info` and `mirror ingest`
            print them.
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
    has_date: bool = True
    has_motion: bool = True
    has_poses: bool = True
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Track:
    """All poses of a drive, as recorded: unsorted, with repeated and wild ones.

    Attributes:
        timestamp_ns: (N,) Unix time, UTC.
        longitude_deg: (N,) WGS 84, or None in a local metric frame.
        latitude_deg: (N,) WGS 84, or None in a local metric frame.
        x_m: (N,) in the local metric frame, or None.
        y_m: (N,) in the local metric frame, or None.
        height_m: (N,) above the ellipsoid (local frame: z), or None where the source has none.
        rotation: (N, 4) unit quaternion, scalar first: ``enu_SE3_ego`` with east-north-up at the pose's position
            (local frame: ``frame_SE3_ego``), or None where the source has no orientation.
        sigma_m: (N,) horizontal 1-sigma of each fix, or None.
        file: the file that the poses come from, for messages.
        bad: rows of the recording that make no pose and are not among the N; None: there are none.
        repeats: number of rows of the recording that are not among the N, as they equal the row before them.

    Raises:
        RecordingError: an array has not N rows, or a rotation not four values.
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
    repeats: int = 0

    def __post_init__(self) -> None:
        count = len(self.timestamp_ns)
        shapes = {"rotation": (count, 4)}
        for name in ("timestamp_ns", "longitude_deg", "latitude_deg", "x_m", "y_m", "height_m", "rotation", "sigma_m"):
            values, shape = getattr(self, name), shapes.get(name, (count,))
            if values is not None and values.shape != shape:
                raise RecordingError(
                    f"{name} has the shape {values.shape}, but there are {count} poses",
                    remedy="mend the reader: each pose has one row in every array",
                    file=self.file,
                    place="track",
                    expected=f"the shape {shape}",
                )

    def __len__(self) -> int:
        return len(self.timestamp_ns)


@dataclass(frozen=True)
class CameraInfo:
    """One camera of a rig.

    Attributes:
        name: canonical name where the rig maps to it, else the source's own.
        source_name: the source's name.
        static_mask: (H, W) non-zero where the image shows the vehicle itself, or None.
        is_calibrated: False: the source states that it has no calibration of this camera.
    """

    name: str
    source_name: str
    static_mask: UInt8 | None = None
    is_calibrated: bool = True


@dataclass(frozen=True)
class RigInfo:
    """The cameras of a vehicle, of which ``reference_camera`` defines the frames."""

    rig_id: str
    cameras: tuple[CameraInfo, ...]
    reference_camera: str


def choose_reference_camera(cameras: Sequence[str]) -> str:
    """Return the reference camera of a rig whose source names none: ``front_wide``, else the first camera.

    Args:
        cameras: names of the cameras, one at least.
    """
    return "front_wide" if "front_wide" in cameras else cameras[0]


@runtime_checkable
class ImageStream(Protocol):
    """The images of one camera in time order; no file is opened before `read`."""

    @property
    def camera(self) -> str:
        """The camera's name."""
        ...

    @property
    def codec(self) -> str:
        """``jpeg`` or ``png``, as `path` and `read` give it; or ``video``, of which `read` gives JPEG images."""
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
        """Return the file with exactly the encoded bytes of this image, to link or copy; if None, use `read`."""
        ...

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield ``(index, encoded bytes)`` for ascending indices, and decode as little as possible."""
        ...


def repeated_stamps(stream: ImageStream) -> Int64:
    """Return the stamps (R,) of images that a stream leaves out because their stamp is repeated.

    A stream that may leave such images out has them as its attribute ``repeated_ns``.
    """
    found: Int64 = getattr(stream, "repeated_ns", np.empty(0, np.int64))
    return found


@dataclass(frozen=True)
class FileStream:
    """Images in files, one encoded image per file."""

    camera: str
    codec: str
    exposure_start_ns: Int64
    exposure_end_ns: Int64
    paths: tuple[str | Path, ...] = field(repr=False)

    def __post_init__(self) -> None:
        if not len(self.paths) == len(self.exposure_start_ns) == len(self.exposure_end_ns):
            raise RecordingError(
                f"{len(self.paths)} images but {len(self.exposure_start_ns)} exposure stamps",
                remedy="mend the reader: each image has a stamp",
                place=f"camera {self.camera}",
            )

    def path(self, index: int) -> str | Path:
        """Return the image's file."""
        return self.paths[index]

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield each file's bytes."""
        for index in indices:
            yield index, read_file(self.paths[index])


@dataclass(frozen=True)
class ReferencedStream:
    """Images in a bucket or on a server: ingest stores their uris and opens none of them.

    Attributes:
        camera: the camera's name.
        codec: ``jpeg`` or ``png``.
        exposure_start_ns: (N,) as in `ImageStream`.
        exposure_end_ns: (N,) as in `ImageStream`.
        uris: absolute uris for fsspec, one per image.
        byte_length: (N,) size of each image; it begins at the first byte of its uri.
        width_px: (N,) width of each image.
        height_px: (N,) height of each image.
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
                f"{len(self.uris)} images but columns of {', '.join(str(len(column)) for column in columns)}",
                place=f"camera {self.camera}",
            )

    def path(self, index: int) -> None:
        """Return None: the image is not a local file."""

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Fetch and yield each image's bytes, one after the other.

        Raises:
            RecordingError: an image cannot be fetched.
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
                    expected="an image that fsspec reads with the packages installed here",
                ) from error
            yield index, data


@runtime_checkable
class Recording(Protocol):
    """One drive. Every method may be called more than once; none writes anything."""

    @property
    def info(self) -> DriveInfo:
        """The drive, the vehicle, and how time and positions were recorded."""
        ...

    @property
    def rig(self) -> RigInfo | None:
        """The cameras; None for a poses-only recording."""
        ...

    def files(self) -> Sequence[tuple[str, Path | str]]:
        """Return every file of the recording as ``(path relative to the recording, path)``, for its fingerprint."""
        ...

    def track(self) -> Track:
        """Return all poses. A drive in several files is one track."""
        ...

    def calibrations(self) -> pa.Table:
        """Return rows of the ``calibrations`` table (`mirror.schema.tables.CALIBRATIONS`), all stages; may be empty."""
        ...

    def images(self) -> Mapping[str, ImageStream]:
        """Return image streams by camera name; empty for a poses-only recording."""
        ...

    def boxes(self) -> pa.Table | None:
        """Return the rows of the ``boxes`` table (`mirror.schema.tables.BOXES`), or None where the source has none."""
        ...


@runtime_checkable
class Reader(Protocol):
    """A reader of one recording format.

    Attributes:
        name: name of the entry point, and value of ``--reader``.
        expects: a description of a path of this format, for messages.
    """

    name: str
    expects: str

    def recognises(self, path: Path) -> bool:
        """Return whether the path has this format, judged by names alone (fast; opens at most one small file)."""
        ...

    def open(self, path: Path, options: Mapping[str, str]) -> Recording:
        """Open a recording.

        Raises:
            RecordingError: naming the file, the place, what was expected and the remedy; also for unknown options.
        """
        ...


@runtime_checkable
class ConfiguredReader(Reader, Protocol):
    """A format whose recordings need a configuration that a person completes, such as the topics of a log."""

    def propose_configuration(self, path: Path, options: Mapping[str, str]) -> str | None:
        """Return a proposed configuration as text, whose first comment says where to save it; None if one exists.

        Raises:
            RecordingError: the recording cannot be read.
        """
        ...


@runtime_checkable
class CollectionReader(Reader, Protocol):
    """A format that keeps several drives in one folder. A drive has the path ``FOLDER/NAME``, which need not exist."""

    def drives(self, path: Path) -> Sequence[str]:
        """Return the names of the drives of a folder that the reader recognises; `open` takes ``path / name``.

        Raises:
            RecordingError: the folder's tables cannot be read.
        """
        ...
