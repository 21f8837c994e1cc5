"""The inputs of `mirror poses`: cameras with lenses and mountings, fixes, and what gives the scale."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera, camera_from_row
from mirror.geometry.poses import COLUMNS
from mirror.localisation.structure.options import ScaleSource, StructureOptions
from mirror.localisation.structure.track_fixes import read_fixes
from mirror.recordings.lens_files import read_lens
from mirror.recordings.protocol import CameraInfo, Recording, RigInfo

_DEFAULT_SIGMA_M: Final = 3.0
_MOUNTING_SIGMA_DEG: Final = 0.3


@dataclass(frozen=True, eq=False)
class MountedCamera:
    """A camera with lens and mounting as the recording has them; None: unknown.

    Attributes:
        info: the camera.
        lens: its lens.
        ego_SE3_camera: its mounting.
        sigma_deg: 1-sigma of the mounting's rotation about each axis.
    """

    info: CameraInfo
    lens: Camera | None
    ego_SE3_camera: Poses | None
    sigma_deg: float


class DriveInputs:
    """The inputs of the registration of one recording.

    Args:
        recording: the recording.
        source: its path, for messages.
        options: settings.

    Raises:
        UsageError: it has no cameras, or nothing gives the scale.
        RecordingError: it cannot be read.
    """

    def __init__(self, recording: Recording, source: Path, options: StructureOptions) -> None:
        self.recording, self.source, self.options = recording, source, options
        rig = recording.rig
        if rig is None or not rig.cameras:
            raise UsageError("the recording has no cameras", file=source, expected="images to register")
        self.rig: RigInfo = rig
        self.cameras = _mounted_cameras(recording, rig)
        name = options.camera or rig.reference_camera
        if name not in self.cameras:
            raise UsageError(
                f"there is no camera {name!r}", file=source, place="--camera",
                expected=f"one of {', '.join(self.cameras)}",
            )  # fmt: skip
        self.camera = self.cameras[name]
        if options.lens is not None:
            self.camera = replace(self.camera, lens=read_lens(options.lens))
        self.streams = recording.images()
        self.fixes = read_fixes(recording, _DEFAULT_SIGMA_M) if recording.info.has_poses else None
        self.scale = self._choose_scale()

    def _choose_scale(self) -> ScaleSource:
        options, mounting = self.options, self.camera.ego_SE3_camera
        height = options.camera_height_m is not None or mounting is not None
        others = [one for one in self.cameras.values() if one.info.name != self.camera.info.name]
        has_rig = mounting is not None and any(one.lens is not None for one in others)
        has = {
            "track": self.fixes is not None,
            "rig": has_rig,
            "height": height,
            "length": options.length_m is not None,
        }
        if options.scale is not None:
            if not has[options.scale]:
                raise UsageError(
                    f"the scale cannot come from {options.scale}", file=self.source, place=f"--scale {options.scale}",
                    expected={
                        "track": "a recording with fixes",
                        "rig": "two cameras with lenses and mountings",
                        "height": "--camera-height-m METRES, or a recorded mounting",
                        "length": "--length-m METRES",
                    }[options.scale],
                )  # fmt: skip
            return options.scale
        # What the user states goes before what is recorded.
        if options.length_m is not None:
            return "length"
        if options.camera_height_m is not None and not has["track"]:
            return "height"
        for source in ("track", "rig", "height"):
            if has[source]:
                return source
        raise UsageError(
            "nothing gives the scale: images alone do not", file=self.source,
            expected="fixes, a calibrated rig, the height of the camera, or the length of the way",
            remedy="give --camera-height-m METRES (above the road), or --length-m METRES (first to last image)",
        )  # fmt: skip


def _mounted_cameras(recording: Recording, rig: RigInfo) -> dict[str, MountedCamera]:
    """Return the cameras with their best calibration: refined, online, factory."""
    rank = {"factory": 0, "online": 1, "refined": 2}
    rows: dict[str, dict[str, Any]] = {}
    for row in recording.calibrations().to_pylist():
        if row["camera"] not in rows or rank[row["stage"]] > rank[rows[row["camera"]]["stage"]]:
            rows[row["camera"]] = row
    found = {}
    for camera in rig.cameras:
        own = rows.get(camera.name)
        if own is None:
            found[camera.name] = MountedCamera(camera, None, None, _MOUNTING_SIGMA_DEG)
            continue
        mounting = Poses.from_columns({name: [own[name]] for name in COLUMNS})
        sigma = _MOUNTING_SIGMA_DEG
        if own["covariance"] is not None:
            variance = np.array(own["covariance"]).reshape(6, 6).diagonal()[:3].mean()
            sigma = max(float(np.degrees(np.sqrt(variance))), 1e-3)
        found[camera.name] = MountedCamera(camera, camera_from_row(own), mounting, sigma)
    return found
