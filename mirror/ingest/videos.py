"""Videos of a traversal: the recording's own compressed frames of the accepted stretch, neither decoded nor encoded."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.ingest.images import PlacedImages
from mirror.recordings.video import CompressedStream, CopiedVideo
from mirror.recordings.video_file import av_error_type, open_video
from mirror.schema.files import unwritable_error


def place_videos(
    stream: CompressedStream,
    selected: Int64,
    stamps_ns: Int64,
    folder: Path,
    *,
    hashing: bool,
    decoding: bool = False,
    advance: Callable[[int], None],
) -> PlacedImages:
    """Put the compressed video of a camera's selected images into a folder.

    Args:
        stream: the camera.
        selected: (N,) ascending indices into the stream.
        stamps_ns: (N,) their mid-exposure stamps; the first one names the file.
        folder: made here.
        hashing: hash the files.
        decoding: decode every frame, and refuse a video that lacks one.
        advance: called with the number of images done since the last call.

    Returns:
        What lies in the folder now.

    Raises:
        RecordingError: the video is broken, lacks a frame, or cannot be copied.
        DatasetError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True)
        copies = stream.copy_video(selected, folder, str(stamps_ns[0]))
    except OSError as error:
        raise unwritable_error(folder, error) from error
    if sum(len(copy.pts) for copy in copies) != len(selected):
        raise RecordingError(
            f"gave {sum(len(copy.pts) for copy in copies)} of {len(selected)} frames",
            file=copies[0].file,
            remedy="mend the reader: it gives each frame that is asked for, once",
        )
    names: list[str] = []
    sizes: list[int] = []
    digests: list[bytes | None] = []
    rasters: list[tuple[int, int]] = []
    for copy in copies:
        width, height = _require_frames(copy) if decoding else _raster(copy.file)
        count = len(copy.pts)
        digest = _sha256(copy.file) if hashing else None
        names += [copy.file.name] * count
        sizes += [copy.file.stat().st_size] * count
        digests += [digest] * count
        rasters += [(width, height)] * count
        advance(count)
    size = np.array(rasters, np.int64)
    pts = np.concatenate([copy.pts for copy in copies])
    return PlacedImages(names, sizes, digests, "video", size[:, 0], size[:, 1], 0, pts)


def _sha256(file: Path) -> bytes:
    """Digest of a file, read in parts: a video may be large."""
    with file.open("rb") as reading:
        return hashlib.file_digest(reading, "sha256").digest()


def _raster(file: Path) -> tuple[int, int]:
    """Width and height of a video's frames, as its header states them."""
    with open_video(file) as (_, stream):
        return stream.codec_context.width, stream.codec_context.height


def _require_frames(copy: CopiedVideo) -> tuple[int, int]:
    """Decode a video, and refuse it if a requested frame is missing or has another size than the header states."""
    raster, pending = _raster(copy.file), set(copy.pts.tolist())
    with open_video(copy.file) as (container, stream):
        try:
            for frame in container.decode(stream):
                if (frame.width, frame.height) == raster:
                    pending.discard(frame.pts)
        except av_error_type() as error:
            raise RecordingError(f"cannot be decoded ({error})", file=copy.file, remedy="restore the video") from error
    if pending:
        raise RecordingError(
            f"{len(pending)} frames cannot be decoded",
            file=copy.file,
            place=f"pts {min(pending)}",
            expected=f"frames of {raster[0]} x {raster[1]} px",
            remedy="restore the video, or take the frames out of its table",
        )
    return raster
