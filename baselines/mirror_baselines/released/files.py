"""Finds the file, and the frame of a video, that shows each view of a plan."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from mirror.dataset.door.placing import hash_file
from mirror.errors import DatasetError, UsageError
from mirror.export.nuscenes import channel_name
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror_baselines.released.generators import Generator

_IMAGES: Final = (".jpg", ".jpeg", ".png")
_COLUMNS: Final = ("file", "traversal_id", "camera", "timestamp_ns", "hz")
_NEAR: Final = 0.25
"""Largest distance of a view from a frame's time, in parts of the time between frames."""


@dataclass(frozen=True)
class ViewSource:
    """The source of a view: an image, or a frame of a video.

    Attributes:
        file: the file.
        frame: number of the frame, counted from 0; None: the file is an image.
    """

    file: Path
    frame: int | None


@dataclass(frozen=True)
class _Clip:
    """A row of the table of clips: a video of one camera, the time of its first frame, frames per recorded second."""

    file: Path
    traversal_id: str
    camera: str
    timestamp_ns: int
    hz: float


@dataclass(frozen=True)
class ReleasedFiles:
    """The output of a generator.

    Attributes:
        generator: what wrote it.
        folder: the folder. If the protocol has several groups, each has a folder of its name in it.
        clips: table (CSV) that places videos in the dataset, with the columns ``file`` (relative to the folder, or to
            that of the group), ``traversal_id``, ``camera``, ``timestamp_ns`` of the first frame and ``hz``, the number
            of frames in a second of the recording. With several groups, ``file`` begins with the group.
        sample: number of the sample, of a generator that draws several.
    """

    generator: Generator
    folder: Path
    clips: Path | None = None
    sample: int = 0

    @property
    def hash(self) -> str:
        """Hash of the names and contents of all files, which identifies the output for a resumed run."""
        files = [(path.relative_to(self.folder).as_posix(), path) for path in _walk(self.folder)]
        if self.clips is not None:
            files.append(("clips", self.clips))
        lines = [f"{name} {hash_file(path)}" for name, path in files]
        return hashlib.sha256("\n".join([*lines, str(self.sample)]).encode()).hexdigest()

    def locate(self, plan: Plan) -> dict[str, ViewSource]:
        """Find the image or the video frame that shows each view, by the view's path.

        Raises:
            UsageError: a folder or the table of clips is missing or broken, or is not used.
            DatasetError: views have no image, or two.
        """
        groups = list(dict.fromkeys(view.group for view in plan.views))
        found: dict[str, ViewSource] = {}
        every_clip = self._read_clips()
        for group in groups:
            folder = self._group_folder(group, alone=len(groups) == 1)
            images = self._index_images(folder)
            clips = [clip for clip in every_clip if clip.file.is_relative_to(folder)]
            for view in plan.views:
                if view.group == group:
                    source = _find_image(view, images) or _find_frame(view, clips)
                    if source is not None:
                        found[view.path] = source
        missing = [view.path for view in plan.views if view.path not in found]
        if missing:
            raise DatasetError(
                f"{len(missing)} of {len(plan.views)} views have no image, such as {missing[0]}",
                file=self.folder,
                expected="an image of each view that the protocol asks for",
                remedy="generate them, or use a protocol of your own that asks for those that exist"
                " (--protocol FILE.toml; its rows have a table of their own)",
            )
        return found

    def _group_folder(self, group: str, *, alone: bool) -> Path:
        folder = self.folder / group
        if folder.is_dir():
            return folder
        if alone and self.folder.is_dir():
            return self.folder
        raise UsageError("no such folder", file=folder, place="--outputs", expected=f"the images of group {group}")

    def _index_images(self, folder: Path) -> Mapping[tuple[str, int], Path]:
        """The images of a folder by channel and time in microseconds."""
        images: dict[tuple[str, int], Path] = {}
        pattern = self.generator.image_name
        for path in _walk(folder) if pattern is not None else ():
            match = pattern.fullmatch(path.stem) if pattern is not None and path.suffix.lower() in _IMAGES else None
            if match is None or int(match.groupdict().get("sample") or self.sample) != self.sample:
                continue
            key = (match["channel"], int(match["us"]))
            if key in images:
                raise DatasetError(
                    f"shows the same instant as {images[key]}", file=path, expected="one image for a camera and time"
                )
            images[key] = path
        return images

    def _read_clips(self) -> Sequence[_Clip]:
        if self.clips is None:
            return ()
        try:
            with self.clips.open(newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise UsageError(
                f"cannot be read: {error}", file=self.clips, place="--clips", remedy="name another file with --clips"
            ) from error
        clips = []
        for number, row in enumerate(rows, start=2):
            try:
                path, traversal, camera, start, hz = (row[name] for name in _COLUMNS)
                clip = _Clip(self.folder / path, traversal, camera, int(start), float(hz))
            except (KeyError, TypeError, ValueError) as error:
                raise UsageError(
                    f"line {number} has no valid {error}",
                    file=self.clips,
                    place="--clips",
                    expected=f"the columns {', '.join(_COLUMNS)}",
                ) from error
            if not 0.0 < clip.hz < 1e4:
                raise UsageError(f"line {number}: {clip.hz:g} Hz", file=self.clips, place="--clips", expected="above 0")
            if not clip.file.is_file():
                raise UsageError(
                    "no such video",
                    file=clip.file,
                    place=f"--clips, line {number}",
                    remedy="correct the name of the video in this line",
                )
            clips.append(clip)
        return clips


def _find_image(view: RenderView, images: Mapping[tuple[str, int], Path]) -> ViewSource | None:
    # The export rounds to microseconds; recordings of nuScenes have whole ones.
    key = (channel_name(view.camera), (view.timestamp_ns + 500) // 1000)
    return ViewSource(images[key], None) if key in images else None


def _find_frame(view: RenderView, clips: Sequence[_Clip]) -> ViewSource | None:
    for clip in clips:
        if (clip.traversal_id, clip.camera) == (view.traversal_id, view.camera):
            place = (view.timestamp_ns - clip.timestamp_ns) * 1e-9 * clip.hz
            frame = round(place)
            if (
                frame >= 0
                and abs(place - frame) <= _NEAR
                and frame < _count_frames(clip.file, clip.file.stat().st_mtime_ns)
            ):
                return ViewSource(clip.file, frame)
    return None


@lru_cache(maxsize=1024)
def _count_frames(file: Path, changed_ns: int) -> int:
    """The number of frames of a video; its packets are counted, not decoded."""
    from mirror.recordings.video_file import read_video_stamps

    return len(read_video_stamps(file)[0])


def _walk(folder: Path) -> Iterator[Path]:
    yield from sorted(path for path in folder.rglob("*") if path.is_file())
