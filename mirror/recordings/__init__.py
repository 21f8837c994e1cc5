"""Fleet recordings: one file per format, all behind the protocol of `mirror.recordings.protocol`."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.recordings.protocol import CameraInfo as CameraInfo
    from mirror.recordings.protocol import DriveInfo as DriveInfo
    from mirror.recordings.protocol import FileStream as FileStream
    from mirror.recordings.protocol import ImageStream as ImageStream
    from mirror.recordings.protocol import Reader as Reader
    from mirror.recordings.protocol import Recording as Recording
    from mirror.recordings.protocol import RigInfo as RigInfo
    from mirror.recordings.protocol import Track as Track
    from mirror.recordings.registry import open_recording as open_recording
    from mirror.schema.tables import CALIBRATIONS as CALIBRATIONS

__all__ = [
    "CALIBRATIONS",
    "CameraInfo",
    "DriveInfo",
    "FileStream",
    "ImageStream",
    "Reader",
    "Recording",
    "RigInfo",
    "Track",
    "open_recording",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "CALIBRATIONS": "mirror.schema.tables",
        "CameraInfo": "mirror.recordings.protocol",
        "DriveInfo": "mirror.recordings.protocol",
        "FileStream": "mirror.recordings.protocol",
        "ImageStream": "mirror.recordings.protocol",
        "Reader": "mirror.recordings.protocol",
        "Recording": "mirror.recordings.protocol",
        "RigInfo": "mirror.recordings.protocol",
        "Track": "mirror.recordings.protocol",
        "open_recording": "mirror.recordings.registry",
    },
)
