"""One camera of a new recording: a folder of images or a video, its times, its lens and its mounting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.geometry.cameras import Camera
from mirror.recordings.assembly.times import ImageTimes, image_times, parse_time, table_times
from mirror.recordings.lens_files import read_lens
from mirror.recordings.mounting import parse_mounting
from mirror.recordings.opening import read_file
from mirror.recordings.paths import list_file_names
from mirror.recordings.raster import read_raster_size
from mirror.recordings.static_masks import decode_static_mask
from mirror.recordings.time import SECOND_NS
from mirror.recordings.video_file import open_video, read_video_stamps, to_unix_stamps

IMAGES: Final = (".jpg", ".jpeg", ".png")
VIDEOS: Final = (".mp4", ".mkv", ".mov", ".avi")


@dataclass(frozen=True)
class GivenCamera:
    """The images, lens, mounting and times that the user gives for a camera.

    Attributes:
        name: the camera's name.
        path: a folder of images of one kind, or a video.
        lens: YAML file, with ``:cam1`` for one camera of a file of Kalibr; None: the camera is uncalibrated.
        mounting: text for `parse_mounting`; None: not given.
        times: table of times; None: those of the images or the video.
        start: time of the first frame of a video; None: that of the container.
        offset_s: seconds that are added to the camera's times.
        static_mask: PNG, non-zero where the image shows the vehicle itself; None: it does not show it.
    """

    name: str
    path: Path
    lens: str | None = None
    mounting: str | None = None
    times: Path | None = None
    start: str | None = None
    offset_s: float = 0.0
    static_mask: Path | None = None


@dataclass(frozen=True, eq=False)
class PreparedCamera:
    """A camera whose inputs were read and fit together.

    Attributes:
        name: the camera's name.
        path: as given.
        is_video: the path is a video.
        keys: (N,) names of files, or time stamps of frames in the video's units.
        start_ns: (N,) ascending start of the exposures, Unix time, with the offset.
        end_ns: (N,) end of the exposures.
        offset_ns: the offset that the times contain.
        source: where the times come from, in words.
        lens: None: the camera is uncalibrated.
        mounting: ``ego_SE3_camera``; None: not given.
        static_mask: as given, of the size of the images.
    """

    name: str
    path: Path
    is_video: bool
    keys: tuple[str, ...]
    start_ns: Int64
    end_ns: Int64
    offset_ns: int
    source: str
    lens: Camera | None
    mounting: tuple[float, ...] | None
    static_mask: Path | None


def prepare_camera(camera: GivenCamera, tz: str | None) -> PreparedCamera:
    """Read times, lens, mounting and mask of a camera, and compare the sizes of image, lens and mask.

    Raises:
        RecordingError: an input is missing or damaged, or the inputs do not fit together.
        UsageError: the mounting is no pose.
    """
    lens = mounting = None
    if camera.mounting is not None:
        mounting = parse_mounting(camera.mounting, f"--mounting {camera.name}")
    if camera.lens is not None:
        file, colon, key = camera.lens.rpartition(":")
        lens = read_lens(Path(file), key) if colon and key.startswith("cam") else read_lens(Path(camera.lens))
        if mounting is None:
            raise RecordingError(
                "a lens without a mounting", file=camera.path, place=f"camera {camera.name}",
                expected="the pose of the camera on the vehicle",
                remedy=f"add --mounting {camera.name}=x,y,z,roll,pitch,yaw (metres and degrees)",
            )  # fmt: skip
    is_video = camera.path.is_file() and camera.path.suffix.lower() in VIDEOS
    if is_video:
        times, size = _video_times(camera, tz)
    elif camera.path.is_dir():
        times, size = _folder_times(camera, tz)
    else:
        raise RecordingError(
            "there is no folder of images or video at this path", file=camera.path, place=f"camera {camera.name}",
            expected=f"a folder of {', '.join(IMAGES)}, or a file {', '.join(VIDEOS)}", remedy="correct --camera",
        )  # fmt: skip
    if lens is not None and (lens.width_px, lens.height_px) != size:
        raise RecordingError(
            f"the images have {size[0]} x {size[1]} px, the lens has {lens.width_px} x {lens.height_px}",
            file=camera.path, place=f"camera {camera.name}", expected="a lens that was calibrated at that size",
            remedy="calibrate the camera with the images that it records",
        )  # fmt: skip
    if camera.static_mask is not None:
        _require_mask(camera.name, camera.static_mask, size)
    offset = round(camera.offset_s * SECOND_NS)
    order = np.argsort(times.start_ns + times.end_ns, kind="stable")
    return PreparedCamera(
        camera.name, camera.path, is_video, tuple(times.names[index] for index in order.tolist()),
        times.start_ns[order] + offset, times.end_ns[order] + offset, offset, times.source, lens, mounting,
        camera.static_mask,
    )  # fmt: skip


def _require_mask(camera: str, file: Path, size: tuple[int, int]) -> None:
    """Refuse a mask that is no PNG of the size of the images."""
    way_out = f"take --static-mask {camera}=... out"
    mask = decode_static_mask(file if file.is_file() else None, file, camera, way_out)
    if file.suffix.lower() != ".png" or (mask.shape[1], mask.shape[0]) != size:
        raise RecordingError(
            f"the mask is a {file.suffix or 'file'} of {mask.shape[1]} x {mask.shape[0]} px, the images have"
            f" {size[0]} x {size[1]} px",
            file=file, place=f"camera {camera}", expected="a PNG of the size of the images",
            remedy=f"draw it on an image of the camera, or {way_out}",
        )  # fmt: skip


def _folder_times(camera: GivenCamera, tz: str | None) -> tuple[ImageTimes, tuple[int, int]]:
    names = [name for name in list_file_names(camera.path, camera.path) if Path(name).suffix.lower() in IMAGES]
    if not names:
        raise RecordingError(
            "the folder has no images", file=camera.path, place=f"camera {camera.name}",
            expected=f"files {', '.join(IMAGES)}", remedy="name the folder that holds the images itself",
        )  # fmt: skip
    times = image_times(camera.path, names, tz) if camera.times is None else table_times(camera.times, "file", tz)
    absent = sorted(set(times.names) - set(names))
    if absent:
        raise RecordingError(
            f"{len(absent)} images of the table are missing, such as {absent[0]}", file=camera.path,
            place=f"camera {camera.name}", expected="every file that the table names", remedy="take the rows out",
        )  # fmt: skip
    file = camera.path / times.names[0]
    return times, read_raster_size(read_file(file), file)


def _video_times(camera: GivenCamera, tz: str | None) -> tuple[ImageTimes, tuple[int, int]]:
    pts, time_base = read_video_stamps(camera.path)
    with open_video(camera.path) as (container, stream):
        size = (int(stream.width), int(stream.height))
        created = container.metadata.get("creation_time") or stream.metadata.get("creation_time")
    if camera.times is not None:
        return _frames_of_table(camera.times, pts, tz), size
    stated = camera.start or created
    if stated is None:
        raise RecordingError(
            "the video does not state when it begins", file=camera.path, place=f"camera {camera.name}",
            expected="the time of its first frame, or a table with frame,timestamp_ns",
            remedy=f"add --start {camera.name}=2026-03-01T10:00:00.250Z, or --times {camera.name}=FILE.csv",
        )  # fmt: skip
    start = parse_time(stated, tz, f"--start {camera.name}" if camera.start else "creation_time")
    stamps = to_unix_stamps(pts, time_base, start)
    source = "its frames, from --start on"
    if camera.start is None:
        source = (
            f"its frames, from its creation_time {created} on, which many cameras round to seconds or set at the end:"
            f" check it, and correct it with --start or --time-offset-s"
        )
    return ImageTimes(tuple(map(str, pts.tolist())), stamps, stamps, source), size


def _frames_of_table(table: Path, pts: Int64, tz: str | None) -> ImageTimes:
    """Times of frames by number; the names become time stamps of the video."""
    times = table_times(table, "frame", tz)
    wrong = [name for name in times.names if not (name.isdecimal() and int(name) < len(pts))]
    if wrong:
        raise RecordingError(
            f"{len(wrong)} frames of the table are not in the video, such as {wrong[0]}", file=table,
            expected=f"numbers from 0 to {len(pts) - 1}", remedy="correct the rows",
        )  # fmt: skip
    return replace(times, names=tuple(str(int(pts[int(name)])) for name in times.names))
