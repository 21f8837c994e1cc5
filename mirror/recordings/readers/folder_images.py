"""Images of the `folder` layout with their exposures: in files, in one video per camera, or at uris elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.folder_document import FolderCamera
from mirror.recordings.opening import find_file
from mirror.recordings.paths import is_remote_uri, list_file_names, list_folder
from mirror.recordings.protocol import FileStream, ImageStream, ReferencedStream
from mirror.recordings.raster import CODECS
from mirror.recordings.tabular import RecordingRows, read_rows
from mirror.recordings.video import VideoStream
from mirror.recordings.video_file import read_video_stamps, to_unix_stamps

_VIDEOS: Final = (".mp4", ".mkv", ".mov", ".avi", ".h264", ".hevc", ".h265")
_EXPOSURES: Final = ("exposure_start_ns", "exposure_end_ns")
_SIZES: Final = ("byte_length", "width_px", "height_px")
_LARGEST: Final = 2**31 - 1


def image_stream(root: Path, camera: str, entry: FolderCamera, *, named: bool = False) -> ImageStream:
    """Return the images of one camera in the order of their exposures.

    Args:
        root: the recording.
        camera: the camera's name.
        entry: its entry in ``recording.json``.
        named: also take images that the table of exposures names and whose files are missing.

    Raises:
        RecordingError: images are missing, have several formats, or differ from their table; camera, file and row are
            named.
    """
    folder = root / "images" / camera
    listed = list_folder(root, root / "videos") if (root / "videos").is_dir() else {}
    videos = [file for name, file in sorted(listed.items()) if file.stem == camera and file.suffix.lower() in _VIDEOS]
    table = find_file(root, f"images/{camera}.csv")
    elsewhere = table is not None and not folder.is_dir()
    if folder.is_dir() + elsewhere + len(videos) != 1:
        sources = [str(file.relative_to(root)) for file in videos]
        sources += [f"images/{camera}"] * folder.is_dir() + [f"images/{camera}.csv"] * elsewhere
        raise RecordingError(
            f"camera {camera} has images in {' and in '.join(sources)}" if sources else f"camera {camera} is missing",
            file=root,
            place=f"camera {camera}",
            expected=f"the folder images/{camera}, one video videos/{camera}.mp4, or images/{camera}.csv with uris",
            remedy="put its images there, or take the camera out of recording.json",
        )
    if table is not None and elsewhere:
        return _referenced_stream(camera, table)
    if videos:
        return _video_stream(root, camera, entry, videos[0])
    return _file_stream(root, camera, folder, table, named=named)


def _file_stream(root: Path, camera: str, folder: Path, table: Path | None, *, named: bool) -> FileStream:
    images = list_file_names(root, folder)
    if not images:
        raise RecordingError(f"camera {camera} has no images", file=folder, expected="<timestamp_ns>.jpg or .png")
    if table is not None:
        start, end, names = _read_listed_files(table, set(images), named=named)
    else:
        names = images
        start = end = _parse_names(folder, names)
    codec = _find_codec(names, folder)
    order, ordered = _sort_by_time(start, end, names, folder)
    # Strings, not Path objects: a camera may have a hundred thousand files.
    return FileStream(camera, codec, start[order], end[order], tuple(f"{folder}/{name}" for name in ordered))


def _referenced_stream(camera: str, table: Path) -> ReferencedStream:
    columns = ("uri", *_EXPOSURES, *_SIZES)
    texts = dict.fromkeys(("uri", *_EXPOSURES), pa.string())
    rows = read_rows([table], types={**texts, **dict.fromkeys(_SIZES, pa.int64())}, columns=columns)
    uris = rows.column("uri").to_pylist()
    wrong = np.array([uri is None or not is_remote_uri(uri) for uri in uris])
    rows.refuse(
        wrong,
        "uri",
        f"{uris[int(np.argmax(wrong))]!r} is not a uri, or refers to this machine's files",
        expected="an absolute uri of an image elsewhere, such as s3://bucket/drive/1.jpg, without '::' and '..'",
        remedy=f"correct it; put local images into images/{camera}",
    )
    sizes = []
    for name in _SIZES:
        values = rows.floats(name)
        off = ~((values >= 1) & (values <= _LARGEST))
        rows.refuse(off, name, "no size", expected=f"a whole number from 1 to {_LARGEST}", remedy="correct the row")
        sizes.append(values.astype(np.int64))
    start, end = _read_exposures(rows)
    codec = _find_codec([urlsplit(uri).path for uri in uris], table)
    order, ordered = _sort_by_time(start, end, uris, table)
    byte_length, width, height = (size[order] for size in sizes)
    return ReferencedStream(camera, codec, start[order], end[order], tuple(ordered), byte_length, width, height)


def _find_codec(names: list[str], file: Path) -> str:
    suffixes = {f".{name.rpartition('.')[2].lower()}" for name in names}
    codecs = {CODECS.get(suffix) for suffix in suffixes}
    codec = codecs.pop()
    if codecs or codec is None:
        raise RecordingError(
            f"images of kinds {', '.join(sorted(suffixes))}", file=file, expected="JPEG or PNG, one kind per camera"
        )
    return codec


def _sort_by_time(start: Int64, end: Int64, names: list[str], file: Path) -> tuple[Int64, list[str]]:
    """Sort images by mid-exposure: the order (N,) as indices, and the sorted names.

    Raises:
        RecordingError: two images have the same time.
    """
    order = np.argsort(start + end, kind="stable")
    ordered = [names[index] for index in order.tolist()]
    middle = (start + end)[order]
    repeated = np.flatnonzero(middle[1:] == middle[:-1])
    if len(repeated):
        first = int(repeated[0])
        raise RecordingError(
            f"{ordered[first]} and {ordered[first + 1]} have the same time",
            file=file,
            expected="one image per camera and instant",
            remedy="remove one of the two",
        )
    return order, ordered


def _parse_names(folder: Path, names: list[str]) -> Int64:
    stems = [name.rpartition(".")[0] for name in names]
    try:
        if not all(map(str.isdecimal, stems)):
            raise ValueError
        return np.array([int(stem) for stem in stems], np.int64)
    except (ValueError, OverflowError) as error:
        odd = next(name for name, stem in zip(names, stems) if not (stem.isdecimal() and len(stem) <= 19))
        raise RecordingError(
            "the name is not a time",
            file=folder / odd,
            expected="<timestamp_ns>.jpg: Unix time of mid-exposure in nanoseconds",
            remedy=f"rename the images, or give images/{folder.name}.csv with file,{','.join(_EXPOSURES)}",
        ) from error


def _read_listed_files(table: Path, images: set[str], *, named: bool) -> tuple[Int64, Int64, list[str]]:
    rows = read_rows([table], types=dict.fromkeys(("file", *_EXPOSURES), pa.string()), columns=("file", *_EXPOSURES))
    names = rows.column("file").to_pylist()
    unknown = np.array([name not in images and not (named and _is_image_name(name)) for name in names])
    rows.refuse(
        unknown,
        "file",
        f"{names[int(np.argmax(unknown))]!r} is no image of images/{table.stem}",
        expected="a file name in that folder, without a path",
        remedy="remove the row, or put the image there",
    )
    unlisted = sorted(images - set(names))
    if unlisted:
        raise RecordingError(
            f"{len(unlisted)} images of images/{table.stem} are not listed, such as {unlisted[0]}",
            file=table,
            expected="one row per image",
            remedy="add the rows, or remove the images",
        )
    start, end = _read_exposures(rows)
    return start, end, names


def _is_image_name(name: str | None) -> bool:
    """Return whether a cell is the name of an image, without a path."""
    return name is not None and not {"/", "\\"} & set(name) and f".{name.rpartition('.')[2].lower()}" in CODECS


def _read_exposures(rows: RecordingRows) -> tuple[Int64, Int64]:
    start, end = (rows.stamps(name, "unix_ns") for name in _EXPOSURES)
    rows.refuse(
        end < start,
        "exposure_end_ns",
        "the exposure ends before it starts",
        expected="at least exposure_start_ns",
        remedy="correct the row",
    )
    return start, end


def _video_stream(root: Path, camera: str, entry: FolderCamera, video: Path) -> VideoStream:
    table = find_file(root, f"videos/{camera}.csv")
    if table is not None:
        names = ("pts", *_EXPOSURES)
        rows = read_rows([table], types={"pts": pa.int64(), **dict.fromkeys(_EXPOSURES, pa.string())}, columns=names)
        missing = np.asarray(rows.column("pts").is_null())
        rows.refuse(missing, "pts", "missing", expected="a time stamp of the video", remedy="correct the row")
        start, end = _read_exposures(rows)
        return VideoStream(camera, start, end, video, np.asarray(rows.column("pts"), np.int64))
    if entry.video_start_ns is None:
        raise RecordingError(
            "the times of its frames are not given",
            file=video,
            expected=f"videos/{camera}.csv with pts,{','.join(_EXPOSURES)}, or video_start_ns in recording.json",
        )
    pts, time_base = read_video_stamps(video)
    stamps = to_unix_stamps(pts, time_base, entry.video_start_ns)
    return VideoStream(camera, stamps, stamps, video, pts)
