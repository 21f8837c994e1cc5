"""Images of the synthetic street with tracks and recorded poses, for the benchmark of the calibration check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.synth_matching.posed_images import urban_drive
from mirror.arrays import Bool, Int64, UInt8
from mirror.calibration.frame_choice import FrameChoice, choose_stretch
from mirror.calibration.tracking import PairTracks
from mirror.synth.driving.trace import TraceMotion
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.model import Label

_STEP_S: Final = 0.05
_JPEG_QUALITY: Final = 90


@dataclass(frozen=True, eq=False)
class DriveTracks:
    """Tracks between the images of one drive.

    Attributes:
        drive: the drive.
        instants_ns: (F,) times of the frames.
        pairs: tracks between neighbouring images of each camera.
        track_s: processor time of the tracker, seconds.
    """

    drive: SynthDrive
    instants_ns: Int64
    pairs: list[PairTracks]
    track_s: float


def choose_instants(drive: SynthDrive, choice: FrameChoice) -> Int64:
    """Times (F,) of the frames that the check would choose."""
    seconds = np.arange(0.0, drive.truth.duration_s, _STEP_S)
    index = choose_stretch(drive.truth.poses(seconds), choice)
    at = np.interp(index, np.arange(len(seconds)), seconds)
    return drive.condition.start_ns + np.round(at * 1e6).astype(np.int64) * 1000


def render_rig(drive: SynthDrive, instants_ns: Int64) -> dict[tuple[int, str], tuple[UInt8, Bool]]:
    """JPEG files of all images by frame and camera, and what is static in them: the encoded image and (H, W)."""
    import cv2

    drive.prepare()
    moving = [number for number, user in enumerate(drive.road_users) if isinstance(user.motion, TraceMotion)]
    out: dict[tuple[int, str], tuple[UInt8, Bool]] = {}
    for frame, instant_ns in enumerate(instants_ns.tolist()):
        instant = drive.at(instant_ns)
        for name in drive.vehicle.cameras:
            image = drive.render(name, instant_ns, instant)
            encoded = cv2.imencode(".jpg", image.bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
            still = ~((image.view.label == Label.EGO) | np.isin(image.view.object, moving))
            out[frame, name] = np.asarray(encoded, np.uint8).ravel(), still
    return out


def make_drive(route: str, light: str, vehicle: str) -> SynthDrive:
    """A drive through the urban scene, 960 px wide."""
    return urban_drive(route, light, vehicle=vehicle)  # type: ignore[arg-type]
