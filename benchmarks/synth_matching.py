"""Feature matching and rig bundle adjustment on the synthetic street, against its exact truth.

``python -m benchmarks synth_matching [--width W] [--frames N] [--draws N]``. SIFT features and verified matches are
pycolmap's (the ``calibration`` extra). Inliers are matches that fit one relative pose; their error is the distance to
where the second picture truly shows the first's point. The rig, seven cameras through a turn, is adjusted from what is
recorded of it: poses with receiver errors, a calibration with errors of mountings and lenses, clocks that are off; the
rest is measured after one rigid alignment of all camera poses.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks._feature_matching import Features, errors_px, features, matches, verified
from benchmarks._rig_adjustment import Spread, adjusted
from benchmarks._street_shots import Shot, taken, urban_drive
from benchmarks._tracks import Key, Rig, triangulated
from benchmarks.report import Row, report
from mirror.arrays import Float64, Int64
from mirror.geometry import Poses, interpolate, matrix_from_quaternion
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.synth.errors import Errors, Stage
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.writing.poses import pose_stamps

HUNDREDS: Final = 200.0
ROTATION_DEG: Final = 0.02
POSITION_CM: Final = 2.0
NEIGHBOURS: Final = (
    ("front_wide", "front_narrow"),
    ("front_wide", "front_left"),
    ("front_wide", "front_right"),
    ("front_left", "rear_left"),
    ("front_right", "rear_right"),
    ("rear_left", "rear"),
    ("rear_right", "rear"),
)
_APART_M: Final = 1.0
_LATER: Final = (1, 2, 3, 5)
_FEWEST: Final = 15
_ROUNDS: Final = 2


@dataclass(frozen=True, eq=False)
class Ride:
    """Pictures of a rig on its way, and what matches in them.

    Attributes:
        drive: of which they are.
        instants_ns: (F,) true times of the frames.
        shots: the pictures.
        features: of them.
        matches: verified pairs (M, 2) of features of two pictures.
    """

    drive: SynthDrive
    instants_ns: Int64
    shots: Mapping[Key, Shot]
    features: Mapping[Key, Features]
    matches: Mapping[tuple[Key, Key], Int64]

    def errors_px(self, one: Key, other: Key) -> Float64:
        """How far the matches of two pictures are off."""
        pairs = self.matches[one, other]
        return errors_px(pairs, self.features[one], self.shots[one], self.features[other], self.shots[other])


def ride_through_turn(frames: int, width_px: int) -> Ride:
    """The saloon turns right: lenses and mountings are told apart by turning alone."""
    drive = urban_drive("turn", width_px=width_px)
    instants = _about_the_bend(drive, frames)
    cameras = list(drive.vehicle.cameras)
    shots = {
        (f, name): shot for f, one in enumerate(taken(drive, instants.tolist(), cameras)) for name, shot in one.items()
    }
    wanted: list[tuple[Key, Key]] = []
    for first in range(frames):
        along = [((first, name), (first + later, name)) for later in _LATER for name in cameras]
        aside = [((first, one), (first + later, other)) for later in range(3) for one, other in NEIGHBOURS]
        wanted += [pair for pair in along + aside if pair[1][0] < frames]
    with ThreadPoolExecutor(2) as pool:
        found = dict(zip(shots, pool.map(features, shots.values())))

        def matched(pair: tuple[Key, Key]) -> Int64:
            one, other = (found[key] for key in pair)
            return verified(matches(one, other), one, shots[pair[0]].camera, other, shots[pair[1]].camera)

        pairs_of = dict(zip(wanted, pool.map(matched, wanted)))
    return Ride(drive, instants, shots, found, pairs_of)


def neighbour_rows(ride: Ride) -> Iterator[Row]:
    """How much of neighbouring pictures matches."""
    cameras = list(ride.drive.vehicle.cameras)
    for name in cameras:
        yield _row(
            f"neighbouring frames, {name}",
            ride,
            lambda one, other, name=name: one[1] == other[1] == name and other[0] == one[0] + 1,  # type: ignore[misc]
        )
    for first, second in NEIGHBOURS:
        yield _row(
            f"same frame, {first} and {second}",
            ride,
            lambda one, other, first=first, second=second: (one[1], other[1]) == (first, second) and one[0] == other[0],  # type: ignore[misc]
        )


def _row(name: str, ride: Ride, chosen: Callable[[Key, Key], bool]) -> Row:
    pairs = [pair for pair in ride.matches if chosen(*pair)]
    counts = [len(ride.matches[pair]) for pair in pairs]
    errors = np.concatenate([ride.errors_px(*pair) for pair in pairs])
    return Row(name, f"{len(pairs)} pairs", float(np.median(counts)), float(np.median(errors)), unit="px")


def recorded_rig(ride: Ride, errors: Errors, stage: Stage, draw: int) -> Rig:
    """What a vehicle believes of itself: measured poses at recorded stamps, a stage's calibration."""
    drive, vehicle = ride.drive, ride.drive.vehicle
    rng = np.random.default_rng([drive.seed, draw])
    stamps = pose_stamps(drive)
    measured = errors.measured(drive.world_SE3_ego(stamps), drive.seconds(stamps), rng)
    clock = errors.clocks(tuple(vehicle.cameras), rng)[CANONICAL_CAMERAS[0]]
    mounting = errors.mounting(stage)
    return Rig(
        {name: errors.believed(camera, rng) for name, camera in vehicle.cameras.items()},
        _stacked([pose @ mounting.draw(rng) for pose in vehicle.ego_SE3_camera.values()]),
        interpolate(stamps, measured, ride.instants_ns + clock.error_ns),
    )


def true_rig(ride: Ride) -> Rig:
    """What it truly is."""
    vehicle = ride.drive.vehicle
    return Rig(
        vehicle.cameras, _stacked(list(vehicle.ego_SE3_camera.values())), ride.drive.world_SE3_ego(ride.instants_ns)
    )


def adjust(ride: Ride, recorded: Rig, errors: Errors, stage: Stage) -> Rig:
    """Triangulate and adjust, twice."""
    mounting = errors.mounting(stage)
    spread = Spread(
        position_m=errors.sigma_m,
        attitude_rad=np.radians(errors.attitude_noise_deg),
        mounting_rad=np.radians(mounting.angle_deg),
        mounting_m=mounting.distance_m,
        focal_share=errors.focal_share,
        centre_share=errors.centre_share,
    )
    fitting = {pair: found for pair, found in ride.matches.items() if len(found) >= _FEWEST}
    rig = recorded
    for _ in range(_ROUNDS):
        rig, _ = adjusted(recorded, rig, triangulated(rig, ride.features, fitting), spread)
    return rig


def off(rig: Rig, true: Rig) -> tuple[Float64, Float64]:
    """How far (F, C) all camera poses are off after one rigid alignment: degrees, and centimetres.

    The alignment is the one of least squares, a bar's angle weighing as much as a bar's distance.
    """
    from scipy.spatial.transform import Rotation

    ones, others = rig.world_SE3_cameras(), true.world_SE3_cameras()
    turns, true_turns = matrix_from_quaternion(ones.rotation), matrix_from_quaternion(others.rotation)
    middle, true_middle = ones.translation.mean(axis=0), others.translation.mean(axis=0)
    angle, distance = np.radians(ROTATION_DEG), 0.01 * POSITION_CM
    arrows = np.concatenate([(ones.translation - middle) / distance, *np.moveaxis(turns, 2, 0) / angle])
    true_arrows = np.concatenate(
        [(others.translation - true_middle) / distance, *np.moveaxis(true_turns, 2, 0) / angle]
    )
    align = Rotation.align_vectors(true_arrows, arrows)[0].as_matrix()
    apart = Rotation.from_matrix(np.swapaxes(true_turns, 1, 2) @ align @ turns).magnitude()
    aside = np.linalg.norm((ones.translation - middle) @ align.T - (others.translation - true_middle), axis=1)
    shape = len(rig.world_SE3_ego), len(rig.cameras)
    return np.degrees(apart).reshape(shape), 100.0 * aside.reshape(shape)


def adjustment_rows(ride: Ride, stage: Stage, draws: int) -> Iterator[Row]:
    """How far the rig is off, as recorded and as adjusted; the worst of all pictures and draws of errors."""
    errors, true = ride.drive.preset.errors, true_rig(ride)
    before, after, times = [], [], []
    for draw in range(draws):
        recorded = recorded_rig(ride, errors, stage, draw)
        start = time.perf_counter()
        rig = adjust(ride, recorded, errors, stage)
        times.append(time.perf_counter() - start)
        before.append(off(recorded, true))
        after.append(off(rig, true))
    size = f"{len(true.world_SE3_ego)} x 7, {draws} draws"
    for place, (what, bar, unit) in enumerate(
        (("rotation (deg)", ROTATION_DEG, "deg"), ("position (cm)", POSITION_CM, "cm"))
    ):
        was, now = (np.array([one[place] for one in many]) for many in (before, after))
        yield Row(f"{what} at most, as recorded ({stage})", size, float(was.max()), float(np.median(was)), unit=unit)
        yield Row(f"{what} at most, adjusted", size, float(now.max()), float(np.median(now)), unit=unit, bar=bar)
    yield Row("seconds for triangulating and adjusting", size, float(np.median(times)))


def _stacked(poses: Sequence[Poses]) -> Poses:
    return Poses(np.concatenate([one.rotation for one in poses]), np.concatenate([one.translation for one in poses]))


def _about_the_bend(drive: SynthDrive, frames: int) -> Int64:
    """Times of frames two metres apart, half of them before the middle of the sharpest bend."""
    seconds = np.arange(0.0, drive.truth.duration_s, 0.05)
    driven = drive.truth.driven_m(seconds)
    turns = matrix_from_quaternion(drive.truth.poses(seconds).rotation)
    course = np.unwrap(np.arctan2(turns[:, 1, 0], turns[:, 0, 0]))
    middle = driven[np.abs(np.gradient(course)).argmax()]
    at = np.interp(middle + _APART_M * (np.arange(frames) - 0.5 * frames), driven, seconds)
    return drive.condition.start_ns + np.round(at * 1e6).astype(np.int64) * 1000


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks synth_matching")
    parser.add_argument("--width", type=int, default=960, help="of a picture")
    parser.add_argument("--frames", type=int, default=24, help="of the rig")
    parser.add_argument("--draws", type=int, default=3, help="of recorded errors")
    options = parser.parse_args(argv)
    ride = ride_through_turn(options.frames, options.width)
    return report(
        "synth_matching",
        {
            "neighbours": neighbour_rows(ride),
            "rig adjustment": adjustment_rows(ride, "online", options.draws),
        },
        errors="median error",
    )
