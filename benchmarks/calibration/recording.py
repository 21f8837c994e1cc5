"""Images of the synthetic street with tracks and recorded poses, for the benchmark of the calibration check."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.synth_matching.posed_images import urban_drive
from mirror.arrays import Bool, Float64, Int64, UInt8
from mirror.calibration.frame_choice import FrameChoice, choose_stretch
from mirror.calibration.rig import TrackedRig
from mirror.calibration.tracking import PairTracks, TrackedImage, track_rig
from mirror.geometry import Poses, interpolate, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.synth.errors import Errors
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.model import Label
from mirror.synth.writing.poses import pose_stamps
from mirror.traffic.placement.trace import TraceMotion

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
    """Return the times (F,) of the frames that the check would choose."""
    seconds = np.arange(0.0, drive.truth.duration_s, _STEP_S)
    index = choose_stretch(drive.truth.poses(seconds), choice)
    at = np.interp(index, np.arange(len(seconds)), seconds)
    return drive.condition.start_ns + np.round(at * 1e6).astype(np.int64) * 1000


def render_rig(drive: SynthDrive, instants_ns: Int64) -> dict[tuple[int, str], tuple[UInt8, Bool]]:
    """Render the images of a rig by frame and camera: their JPEG bytes, and masks (H, W) of static pixels."""
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


def make_drive(route: str, light: str, vehicle: str, visit: int = 0) -> SynthDrive:
    """Return a drive through the urban scene, 960 px wide; another visit has other traffic."""
    return urban_drive(route, light, vehicle=vehicle, visit=visit)  # type: ignore[arg-type]


def track_drive(drive: SynthDrive, instants_ns: Int64) -> DriveTracks:
    """Render the images of a drive, store them as JPEG, and track points between them."""
    import cv2

    images = render_rig(drive, instants_ns)

    def load(frame: int, camera: str) -> TrackedImage:
        encoded, still = images[frame, camera]
        return TrackedImage.from_grey(np.asarray(cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE), np.uint8), still)

    poses = {
        name: drive.world_SE3_ego(instants_ns) @ mounting for name, mounting in drive.vehicle.ego_SE3_camera.items()
    }
    start = time.process_time()
    pairs = track_rig(load, drive.vehicle.cameras, poses, len(instants_ns)).pairs
    return DriveTracks(drive, instants_ns, pairs, time.process_time() - start)


def recorded_rig(
    tracks: DriveTracks, draw: int, angle_deg: tuple[float, float], *, exact: bool
) -> tuple[TrackedRig, Float64]:
    """Return a rig as recorded: measured poses, lenses and mounting positions, and rotation errors that are injected.

    Args:
        tracks: the drive with its tracks.
        draw: seed of the errors.
        angle_deg: smallest and largest angle of the injected rotation errors, about random axes.
        exact: poses, lenses and positions are the true ones; only the rotations are wrong.

    Returns:
        The rig, and the injected errors (C, 3) about the vehicle's axes, degrees.
    """
    drive = tracks.drive
    rng = np.random.default_rng([draw, 5])
    errors = Errors.none() if exact else drive.preset.errors
    stamps = pose_stamps(drive)
    measured = errors.perturb_poses(drive.world_SE3_ego(stamps), drive.seconds(stamps), rng)
    poses = drive.world_SE3_ego(tracks.instants_ns) if exact else interpolate(stamps, measured, tracks.instants_ns)
    cameras: dict[str, Camera] = {}
    mountings: dict[str, Poses] = {}
    injected = np.empty((len(drive.vehicle.cameras), 3))
    for number, (name, camera) in enumerate(drive.vehicle.cameras.items()):
        cameras[name] = errors.perturb_camera(camera, rng)
        axis = rng.normal(size=3)
        injected[number] = rng.uniform(*angle_deg) * axis / np.linalg.norm(axis)
        true = drive.vehicle.ego_SE3_camera[name]
        turn = Poses.exp(np.concatenate([np.radians(injected[number]), np.zeros(3)])[None])
        shift = rng.normal(0.0, errors.online.distance_m, (1, 3))
        mountings[name] = Poses((turn @ Poses(true.rotation, np.zeros((1, 3)))).rotation, true.translation + shift)
    rig = TrackedRig(cameras, mountings, drive.seconds(tracks.instants_ns), dict.fromkeys(cameras, poses), tracks.pairs)
    return rig, injected


def straightest_instants(drive: SynthDrive, choice: FrameChoice) -> Int64:
    """Return the times (F,) of frames on the straightest stretch of a drive."""
    seconds = np.arange(0.0, drive.truth.duration_s, _STEP_S)
    driven = drive.truth.driven_m(seconds)
    turns = matrix_from_quaternion(drive.truth.poses(seconds).rotation)
    course = np.unwrap(np.arctan2(turns[:, 1, 0], turns[:, 0, 0]))
    length = choice.step_m * (choice.frames - 1)
    starts = np.arange(0.0, driven[-1] - length, 2.0)
    spans = [np.ptp(course[slice(*np.searchsorted(driven, [start, start + length]))]) for start in starts]
    at = np.interp(starts[int(np.argmin(spans))] + choice.step_m * np.arange(choice.frames), driven, seconds)
    return drive.condition.start_ns + np.round(at * 1e6).astype(np.int64) * 1000
