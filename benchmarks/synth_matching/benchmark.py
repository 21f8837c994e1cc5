"""Feature matching and rig bundle adjustment on the synthetic street, compared with its exact truth.

``python -m benchmarks synth_matching [--width W] [--frames N] [--draws N]``. SIFT features, two-view geometries and
triangulation are pycolmap's (the ``calibration`` extra). Inliers are matches that fit one relative pose; their error is
the distance to the true position of the first image's point in the second image. The rig of seven cameras on a turn is
adjusted from its recording: poses with a receiver's errors, a calibration with errors of mountings and lenses, and
clocks with offsets. The remaining error is measured after one rigid alignment of all camera poses.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.report import Row, report
from benchmarks.synth_matching.adjustment import Spread, adjust_rig
from benchmarks.synth_matching.features import (
    Features,
    extract_features,
    match_errors_px,
    match_features,
    verify_matches,
)
from benchmarks.synth_matching.posed_images import PosedImage, render_frames, urban_drive
from benchmarks.synth_matching.tracks import Key, Rig, triangulate_tracks
from mirror.arrays import Float64, Int64
from mirror.geometry import Poses, interpolate, matrix_from_quaternion
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.synth.errors import Errors
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.writing.poses import pose_stamps

ROTATION_DEG: Final = 0.02
POSITION_CM: Final = 2.0
FEW: Final = 200
FEW_PERCENT: Final = 10.0
NEIGHBOURS: Final = (
    ("front_wide", "front_narrow"),
    ("front_wide", "front_left"),
    ("front_wide", "front_right"),
    ("front_left", "rear_left"),
    ("front_right", "rear_right"),
    ("rear_left", "rear"),
    ("rear_right", "rear"),
)
VISITS: Final = (
    ("another day", "day", "clear", "2025-09-16"),
    ("a day of rain", "day", "rain", "2025-10-22"),
    ("dusk", "dusk", "clear", "2025-06-11"),
    ("night", "night", "clear", "2025-06-11"),
)
_APART_M: Final = 1.0
_LATER: Final = (1, 2, 3, 5)
_PLACES: Final = 10
_FEWEST: Final = 15


@dataclass(frozen=True, eq=False)
class RigRecording:
    """Images of a moving rig, with their features and matches.

    Attributes:
        drive: drive of the images.
        instants_ns: (F,) true times of the frames.
        images: the images.
        features: features of each image.
        matches: verified pairs (M, 2) of features of two images.
    """

    drive: SynthDrive
    instants_ns: Int64
    images: Mapping[Key, PosedImage]
    features: Mapping[Key, Features]
    matches: Mapping[tuple[Key, Key], Int64]

    def errors_px(self, one: Key, other: Key) -> Float64:
        """Return the errors of the matches of two images, pixels."""
        pairs = self.matches[one, other]
        return match_errors_px(pairs, self.features[one], self.images[one], self.features[other], self.images[other])


def record_turn(frames: int, width_px: int) -> RigRecording:
    """Render and match a right turn of the saloon; only a turn separates lens errors from mounting errors."""
    drive = urban_drive("turn", width_px=width_px)
    instants, cameras = _instants_around_bend(drive, frames), list(drive.vehicle.cameras)
    images = {
        (f, name): shot for f, one in enumerate(render_frames(drive, instants, cameras)) for name, shot in one.items()
    }
    pairs_to_match: list[tuple[Key, Key]] = []
    for first in range(frames):
        along = [((first, name), (first + later, name)) for later in _LATER for name in cameras]
        aside = [((first, one), (first + later, other)) for later in range(3) for one, other in NEIGHBOURS]
        pairs_to_match += [pair for pair in along + aside if pair[1][0] < frames]
    with ThreadPoolExecutor(2) as pool:
        found = dict(zip(images, pool.map(extract_features, images.values())))

        def match_pair(pair: tuple[Key, Key]) -> Int64:
            one, other = pair
            return _match_and_verify(found[one], images[one], found[other], images[other])

        return RigRecording(
            drive, instants, images, found, dict(zip(pairs_to_match, pool.map(match_pair, pairs_to_match)))
        )


def neighbour_rows(recording: RigRecording) -> Iterator[Row]:
    """Yield numbers of inliers and errors of neighbouring images."""
    few, count = 0, 0
    for name in recording.drive.vehicle.cameras:
        pairs = [
            (one, other) for one, other in recording.matches if one[1] == other[1] == name and other[0] == one[0] + 1
        ]
        inliers = [len(recording.matches[pair]) for pair in pairs]
        few, count = few + sum(number < FEW for number in inliers), count + len(inliers)
        yield _row(f"inliers, frames 1 m apart, {name}", inliers, [recording.errors_px(*pair) for pair in pairs])
    yield Row(
        f"frames 1 m apart with less than {FEW} inliers (%)", f"{count} pairs", 100.0 * few / count, bar=FEW_PERCENT
    )
    for first, second in NEIGHBOURS:
        pairs = [
            pair
            for pair in recording.matches
            if pair[0][0] == pair[1][0] and (pair[0][1], pair[1][1]) == (first, second)
        ]
        inliers = [len(recording.matches[pair]) for pair in pairs]
        yield _row(f"inliers, {first} and {second}", inliers, [recording.errors_px(*pair) for pair in pairs])


def visit_rows(width_px: int) -> Iterator[Row]:
    """Yield inliers and errors between two traversals, for front wide images at nearly the same positions."""
    camera = CANONICAL_CAMERAS[0]
    base = urban_drive("along", width_px=width_px)
    seconds, places = _positions(base)
    driven = base.truth.driven_m(seconds)
    at = np.searchsorted(driven, np.linspace(0.1, 0.9, _PLACES) * driven[-1])
    ours = [one[camera] for one in render_frames(base, _instants(base, seconds[at]), [camera])]
    known = [extract_features(shot) for shot in ours]
    for visit, (name, light, weather, date) in enumerate(VISITS, start=1):
        other = urban_drive("along", light, weather, date=date, visit=visit, width_px=width_px)  # type: ignore[arg-type]
        other_seconds, other_places = _positions(other)
        apart = np.linalg.norm(places[at][:, None] - other_places[None], axis=2)
        theirs = [
            one[camera] for one in render_frames(other, _instants(other, other_seconds[apart.argmin(axis=1)]), [camera])
        ]
        inliers, errors = [], []
        for one, shot, there in zip(known, ours, theirs):
            found = extract_features(there)
            pairs = _match_and_verify(one, shot, found, there)
            inliers.append(len(pairs))
            errors.append(match_errors_px(pairs, one, shot, found, there))
        yield _row(f"inliers, a day and {name}", inliers, errors)
        other.forget()


def recorded_rig(recording: RigRecording, errors: Errors, draw: int) -> Rig:
    """Return the rig as recorded: measured poses at recorded timestamps, and an online calibration."""
    drive, vehicle = recording.drive, recording.drive.vehicle
    rng = np.random.default_rng([drive.seed, draw])
    stamps = pose_stamps(drive)
    measured = errors.perturb_poses(drive.world_SE3_ego(stamps), drive.seconds(stamps), rng)
    clock = errors.draw_clocks(tuple(vehicle.cameras), rng)[CANONICAL_CAMERAS[0]]
    return Rig(
        {name: errors.perturb_camera(camera, rng) for name, camera in vehicle.cameras.items()},
        _stack_poses([pose @ errors.online.draw(rng) for pose in vehicle.ego_SE3_camera.values()]),
        interpolate(stamps, measured, recording.instants_ns + clock.error_ns),
    )


def true_rig(recording: RigRecording) -> Rig:
    """Return the true rig."""
    vehicle = recording.drive.vehicle
    mountings = _stack_poses(list(vehicle.ego_SE3_camera.values()))
    return Rig(vehicle.cameras, mountings, recording.drive.world_SE3_ego(recording.instants_ns))


def adjust(recording: RigRecording, recorded: Rig, errors: Errors) -> Rig:
    """Triangulate the matches and adjust the rig to them."""
    spread = Spread(
        position_m=errors.sigma_m,
        attitude_rad=np.radians(errors.attitude_noise_deg),
        mounting_rad=np.radians(errors.online.angle_deg),
        mounting_m=errors.online.distance_m,
        focal_share=errors.focal_share,
        centre_share=errors.centre_share,
    )
    fitting = {pair: found for pair, found in recording.matches.items() if len(found) >= _FEWEST}
    return adjust_rig(recorded, triangulate_tracks(recorded, recording.features, fitting), spread)[0]


def pose_errors(rig: Rig, true: Rig) -> tuple[Float64, Float64]:
    """Return the errors (F, C) of all camera poses after one rigid alignment: degrees, and centimetres.

    The alignment is a least-squares fit in which the rotation bar has the same weight as the position bar.
    """
    from scipy.spatial.transform import Rotation

    ones, others = rig.world_SE3_cameras(), true.world_SE3_cameras()
    turns, true_turns = matrix_from_quaternion(ones.rotation), matrix_from_quaternion(others.rotation)
    places, true_places = (one.translation - one.translation.mean(axis=0) for one in (ones, others))
    angle, distance = np.radians(ROTATION_DEG), 0.01 * POSITION_CM
    arrows = np.concatenate([places / distance, *np.moveaxis(turns, 2, 0) / angle])
    true_arrows = np.concatenate([true_places / distance, *np.moveaxis(true_turns, 2, 0) / angle])
    align = Rotation.align_vectors(true_arrows, arrows)[0].as_matrix()
    apart = Rotation.from_matrix(np.swapaxes(true_turns, 1, 2) @ align @ turns).magnitude()
    aside = np.linalg.norm(places @ align.T - true_places, axis=1)
    shape = len(rig.world_SE3_ego), len(rig.cameras)
    return np.degrees(apart).reshape(shape), 100.0 * aside.reshape(shape)


def adjustment_rows(recording: RigRecording, draws: int) -> Iterator[Row]:
    """Yield the largest and the median error of the recorded and the adjusted rig, over all images and draws."""
    errors, true = recording.drive.preset.errors, true_rig(recording)
    before, after, times = [], [], []
    for draw in range(draws):
        recorded = recorded_rig(recording, errors, draw)
        start = time.perf_counter()
        rig = adjust(recording, recorded, errors)
        times.append(1e3 * (time.perf_counter() - start))
        before.append(pose_errors(recorded, true))
        after.append(pose_errors(rig, true))
    size = f"{len(true.world_SE3_ego)} x 7, {draws} draws"
    for place, (what, bar, unit) in enumerate((("rotation", ROTATION_DEG, "deg"), ("position", POSITION_CM, "cm"))):
        was, now = (np.array([one[place] for one in many]) for many in (before, after))
        yield Row(f"{what}, recorded ({unit})", size, float(was.max()), float(np.median(was)), unit=unit)
        yield Row(f"{what}, adjusted ({unit})", size, float(now.max()), float(np.median(now)), unit=unit, bar=bar)
    yield Row("triangulation and adjustment", size, float(np.median(times)))


def _row(name: str, inliers: Sequence[int], errors: Sequence[Float64]) -> Row:
    """A row of medians."""
    off_px = float(np.median(np.concatenate(errors)))
    return Row(name, f"{len(inliers)} pairs", float(np.median(inliers)), off_px, unit="px")


def _match_and_verify(one: Features, first: PosedImage, other: Features, second: PosedImage) -> Int64:
    return verify_matches(match_features(one, other), one, first.camera, other, second.camera)


def _stack_poses(poses: Sequence[Poses]) -> Poses:
    return Poses(np.concatenate([one.rotation for one in poses]), np.concatenate([one.translation for one in poses]))


def _positions(drive: SynthDrive) -> tuple[Float64, Float64]:
    """Seconds (T,) of a drive, and its positions (T, 3)."""
    seconds = np.arange(0.0, drive.truth.duration_s, 0.05)
    return seconds, drive.truth.poses(seconds).translation


def _instants(drive: SynthDrive, seconds: Float64) -> Int64:
    return drive.condition.start_ns + np.round(seconds * 1e6).astype(np.int64) * 1000


def _instants_around_bend(drive: SynthDrive, frames: int) -> Int64:
    """Times of frames one metre apart, half of them before the middle of the sharpest bend."""
    seconds, _ = _positions(drive)
    driven = drive.truth.driven_m(seconds)
    turns = matrix_from_quaternion(drive.truth.poses(seconds).rotation)
    course = np.unwrap(np.arctan2(turns[:, 1, 0], turns[:, 0, 0]))
    middle = driven[np.abs(np.gradient(course)).argmax()]
    return _instants(drive, np.interp(middle + _APART_M * (np.arange(frames) - 0.5 * frames), driven, seconds))


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks synth_matching")
    parser.add_argument("--width", type=int, default=1280, help="width of an image, px")
    parser.add_argument("--frames", type=int, default=20, help="number of frames of the rig")
    parser.add_argument("--draws", type=int, default=3, help="number of draws of the recorded errors")
    options = parser.parse_args(argv)
    recording = record_turn(options.frames, options.width)
    return report(
        "synth_matching",
        {
            "neighbours": neighbour_rows(recording),
            "traversals": visit_rows(options.width),
            "rig adjustment": adjustment_rows(recording, options.draws),
        },
        errors="median error",
    )
