"""The track that a camera writes into its video: GoPro's GPMF and Google's CAMM in mp4 and mov files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from mirror.errors import RecordingError
from mirror.recordings.readers.camm import CLOCKS, read_camm
from mirror.recordings.readers.collection import one_of
from mirror.recordings.readers.gpmf import read_gpmf
from mirror.recordings.readers.mp4_metadata import find_metadata_format, read_metadata_track
from mirror.recordings.readers.track_files import TrackRecording, require_track_file

_SUFFIXES: Final = (".mp4", ".mov", ".360")
_FORMATS: Final = ("gpmd", "camm")


class VideoGpsReader:
    """A reader of the fixes in a video as one drive, without images."""

    name = "video_gps"
    expects = "a video *.mp4 or *.mov with a track of fixes of GoPro (GPMF) or Google (CAMM)"

    def recognises(self, path: Path) -> bool:
        """Return whether a file is a video with fixes, judged by its suffix and its index."""
        return path.is_file() and path.suffix.lower() in _SUFFIXES and find_metadata_format(path, _FORMATS) is not None

    def open(self, path: Path, options: Mapping[str, str]) -> TrackRecording:
        """Open a file.

        The options ``drive_id``, ``vehicle_id`` and ``vehicle_type`` name the drive. ``clock`` is the epoch of the
        fixes of CAMM: ``gps``, or ``unix`` for cameras that write Unix time.
        """
        others = {name: value for name, value in options.items() if name != "clock"}
        require_track_file(path, others, self.name, self.expects)
        clock = one_of(options, "clock", CLOCKS, path)
        track = read_metadata_track(path, _FORMATS)
        if track.format == "camm":
            return TrackRecording(path, f"{clock} time (CAMM)", others, read_camm(track, clock))
        if "clock" in options:
            raise RecordingError(
                "clock is an option for CAMM", file=path, place="option clock", expected="fixes of GPMF have UTC",
                remedy="leave the option out",
            )  # fmt: skip
        return TrackRecording(path, "UTC (GPMF)", others, read_gpmf(track))
