"""Rig refinement on the synthetic street: images of a turn, features, matches, and the adjustment of ours and pycolmap.

Several traversals are drives of one vehicle type over the same turn with other traffic, each with recorded poses and
mountings of its own, as `mirror calibrate refine` sees them; their images are matched with each other too. A row with
exact lenses shows what the errors of the recorded lenses cost: an error of a principal point acts like a rotation.

Both adjust the same tracks from the same triangulated points. pycolmap has no priors of lenses and poses: its lenses
stay as recorded, and its poses are free. It has no f-theta lenses, so it is not run on the hatchback, and its rig is
that of one traversal.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from benchmarks.calibration.recording import DriveTracks, choose_instants, make_drive, recorded_rig, render_rig
from benchmarks.report import Peer, Row
from benchmarks.synth_matching.features import colmap, colmap_camera
from mirror.arrays import Bool, Float64
from mirror.calibration.frame_choice import FrameChoice
from mirror.calibration.refinement.adjustment import Adjustment, adjust_rigs, rotations
from mirror.calibration.refinement.features import ImageFeatures, find_features
from mirror.calibration.refinement.matching import MatchingOptions, choose_pairs, join_tracks, match_pair
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs, RefinementPrior
from mirror.calibration.refinement.run import DEFAULT_CHOICE
from mirror.calibration.refinement.triangulation import triangulate
from mirror.calibration.sampling import stack_poses
from mirror.calibration.tracking import TrackedImage
from mirror.geometry import Poses, matrix_from_quaternion

VEHICLES: Final = ("saloon", "suv", "hatchback")
LIGHTS: Final = ("day", "night")
INJECTED_DEG: Final = (0.05, 1.0)
_MEDIAN_DEG: Final = 0.03
_WORST_DEG: Final = 0.06
_ADJUST_S: Final = 15.0
_LOSS_PX: Final = 0.3
_PEER_DRAWS: Final = 2
_EXACT_LENSES: Final = RefinementPrior(focal_share=1e-7, centre_share=1e-7)
_SEED_OF_VISIT: Final = 1000
"""Added to the seed of the recorded errors for each further traversal."""


@dataclass(frozen=True, eq=False)
class MatchedDrives:
    """The tracks of the traversals of one turn.

    Attributes:
        drives: the drives, with the times of their frames.
        tracks: tracks of features.
        features_s: processor time of the features.
        matches_s: processor time of the matches.
    """

    drives: Sequence[DriveTracks]
    tracks: FeatureTracks
    features_s: float
    matches_s: float


def match_drives(light: str, vehicle: str, choice: FrameChoice, traversals: int) -> MatchedDrives:
    """Render the traversals of a turn, store the images as JPEG, and match their features."""
    import cv2

    options = MatchingOptions()
    drives: list[DriveTracks] = []
    features: list[ImageFeatures] = []
    features_s = 0.0
    for visit in range(traversals):
        drive = make_drive("turn", light, vehicle, visit)
        instants = choose_instants(drive, choice)
        images = render_rig(drive, instants)
        drive.forget()
        start = time.process_time()
        for frame in range(len(instants)):
            for name in drive.vehicle.cameras:
                encoded, still = images[frame, name]
                grey = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE), np.uint8)
                features.append(find_features(TrackedImage.from_grey(grey, still), options.features))
        features_s += time.process_time() - start
        drives.append(DriveTracks(drive, instants, [], 0.0))
    start = time.process_time()
    rigs = recorded_rigs(drives, 0)
    matches = {
        (one, other): match_pair(rigs, one, other, features, options)
        for one, other in choose_pairs(rigs, options).tolist()
    }
    tracks = join_tracks(features, {pair: found for pair, found in matches.items() if len(found)})
    return MatchedDrives(drives, tracks, features_s, time.process_time() - start)


def recorded_rigs(drives: Sequence[DriveTracks], draw: int) -> MovingRigs:
    """Return the rigs as recorded, with injected rotation errors."""
    rigs = [
        recorded_rig(drive, draw + _SEED_OF_VISIT * visit, INJECTED_DEG, exact=False)[0]
        for visit, drive in enumerate(drives)
    ]
    # Positions of all images, frames and mountings of the traversals one after another.
    frames, counts = [len(rig.time_s) for rig in rigs], [len(rig.cameras) for rig in rigs]
    frame = [np.repeat(np.arange(f), c) for f, c in zip(frames, counts)]
    mounting = [np.tile(np.arange(c), f) for f, c in zip(frames, counts)]
    return MovingRigs(
        [camera for rig in rigs for camera in rig.cameras.values()],
        stack_poses([pose for rig in rigs for pose in rig.ego_SE3_camera.values()]),
        stack_poses([rig.world_SE3_ego[rig.names[0]][own] for rig, own in zip(rigs, frame)]),
        np.concatenate([own + first for own, first in zip(frame, np.cumsum([0, *frames]))]),
        np.concatenate([own + first for own, first in zip(mounting, np.cumsum([0, *counts]))]),
        np.concatenate([rig.time_s - rig.time_s[0] for rig in rigs]),
        np.repeat(np.arange(len(rigs)), frames),
    )


def with_exact_lenses(rigs: MovingRigs, drives: Sequence[DriveTracks]) -> MovingRigs:
    """Return the rigs with the true lenses."""
    return replace(rigs, cameras=[camera for item in drives for camera in item.drive.vehicle.cameras.values()])


def true_rotations(drives: Sequence[DriveTracks]) -> Float64:
    """Return the true rotations (K, 3, 3) of the mountings."""
    mountings = stack_poses([one for item in drives for one in item.drive.vehicle.ego_SE3_camera.values()])
    return matrix_from_quaternion(mountings.rotation)


def angles_deg(turns: Float64, true: Float64, traversals: int = 1) -> tuple[Float64, Float64]:
    """Return the angles relative to the first camera of each traversal, the reference, and (K,) to the vehicle."""
    of_rigs = [matrices.reshape(traversals, -1, 3, 3) for matrices in (turns, true)]
    relative = [(np.swapaxes(rigs[:, :1], 2, 3) @ rigs[:, 1:]).reshape(-1, 3, 3) for rigs in of_rigs]
    return tuple(
        np.degrees(np.linalg.norm(rotations(np.swapaxes(b, 1, 2) @ a).log()[:, :3], axis=1))
        for a, b in (tuple(relative), (turns, true))
    )


def is_covered(adjusted: Adjustment, true: Float64) -> Bool:
    """Mark which rotations (K, 3) to the vehicle have the truth in their 95 % intervals."""
    turns = matrix_from_quaternion(adjusted.ego_SE3_camera.rotation)
    off = rotations(np.swapaxes(true, 1, 2) @ turns).log()[:, :3]
    sigma = np.stack(
        [np.sqrt(np.diag(adjusted.covariance)[adjusted.mounting_columns(k)][:3]) for k in range(len(true))]
    )
    return np.asarray(np.abs(off) < 1.96 * sigma, np.bool_)


def adjust_with_pycolmap(rigs: MovingRigs, tracks: FeatureTracks) -> Float64:
    """Adjust a rig with pycolmap's bundle adjustment; the first camera is its reference.

    Returns:
        (K, 3, 3) rotations relative to the first camera.
    """
    pycolmap = colmap()
    points, usable = triangulate(rigs, tracks)
    usable = usable & np.isfinite(points[tracks.track]).all(axis=1)
    reconstruction, sensor = pycolmap.Reconstruction(), pycolmap.SensorType.CAMERA
    mountings = rigs.ego_SE3_camera.inverse() @ rigs.ego_SE3_camera[np.zeros(len(rigs.cameras), np.int64)]
    rig = pycolmap.Rig(rig_id=1)
    for number, camera in enumerate(rigs.cameras):
        reconstruction.add_camera(colmap_camera(camera, number + 1))
        identity = pycolmap.sensor_t(sensor, number + 1)
        if number:
            rig.add_sensor(identity, _rigid(mountings, number))
        else:
            rig.add_ref_sensor(identity)
    reconstruction.add_rig(rig)
    reference = (rigs.world_SE3_ego @ rigs.ego_SE3_camera[np.zeros(len(rigs.frame), np.int64)]).inverse()
    places: dict[int, dict[int, int]] = {}
    for number in range(len(rigs.time_s)):
        own = np.flatnonzero(rigs.frame == number)
        frame = pycolmap.Frame(frame_id=number + 1, rig_id=1, rig_from_world=_rigid(reference, int(own[0])))
        for image in own.tolist():
            frame.add_data_id(pycolmap.data_t(pycolmap.sensor_t(sensor, int(rigs.mounting[image]) + 1), image + 1))
        reconstruction.add_frame(frame)
        for image in own.tolist():
            rows = np.flatnonzero((tracks.image == image) & usable)
            places[image] = {int(row): place for place, row in enumerate(rows)}
            made = pycolmap.Image(
                f"{image}", tracks.uv_px[rows], camera_id=int(rigs.mounting[image]) + 1, image_id=image + 1
            )
            made.frame_id = number + 1
            reconstruction.add_image(made)
        reconstruction.register_frame(number + 1)
    starts = tracks.starts
    for number in range(len(tracks)):
        kept = [row for row in range(int(starts[number]), int(starts[number + 1])) if usable[row]]
        if len(kept) >= 2:
            elements = [
                pycolmap.TrackElement(int(tracks.image[row]) + 1, places[int(tracks.image[row])][row]) for row in kept
            ]
            reconstruction.add_point3D(points[number], pycolmap.Track(elements))
    _solve_with_pycolmap(pycolmap, reconstruction, len(rigs.frame))
    out = np.empty((len(rigs.cameras), 3, 3))
    for number in range(len(rigs.cameras)):
        pose = reconstruction.rigs[1].sensor_from_rig(pycolmap.sensor_t(sensor, number + 1)) if number else None
        out[number] = np.eye(3) if pose is None else pose.rotation.matrix().T
    return out


def _rigid(poses: Poses, number: int) -> Any:
    pycolmap = colmap()
    return pycolmap.Rigid3d(pycolmap.Rotation3d(np.roll(poses.rotation[number], -1)), poses.translation[number])


def _solve_with_pycolmap(pycolmap: Any, reconstruction: Any, images: int) -> None:
    for loss_px in (5.0, _LOSS_PX):
        options = pycolmap.BundleAdjustmentOptions(
            refine_focal_length=False, refine_principal_point=False, refine_extra_params=False,
            refine_rig_from_world=True, refine_sensor_from_rig=True, refine_points3D=True, print_summary=False,
        )  # fmt: skip
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = loss_px
        options.ceres.solver_options.num_threads = 1
        options.ceres.solver_options.max_num_iterations = 30
        config = pycolmap.BundleAdjustmentConfig()
        for number in range(images):
            config.add_image(number + 1)
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()


def refine_rows(
    draws: int,
    vehicles: Sequence[str] = VEHICLES,
    lights: Sequence[str] = LIGHTS,
    *,
    frames: int = DEFAULT_CHOICE.frames,
    traversals: int = 1,
) -> Iterator[Row]:
    """Yield errors and times of the refinement, for each rig, by day and by night."""
    choice = replace(DEFAULT_CHOICE, frames=frames)
    cover: list[Bool] = []
    every: dict[str, list[Float64]] = {}
    for light in lights:
        for vehicle in vehicles:
            matched = match_drives(light, vehicle, choice, traversals)
            true = true_rotations(matched.drives)
            relative: list[Float64] = []
            whole: list[Float64] = []
            exact: list[Float64] = []
            before: list[Float64] = []
            times: list[float] = []
            others: list[Float64] = []
            other_times: list[float] = []
            for draw in range(draws):
                rigs = recorded_rigs(matched.drives, draw)
                start = time.process_time()
                adjusted = adjust_rigs(rigs, matched.tracks)
                times.append(time.process_time() - start)
                turns = matrix_from_quaternion(adjusted.ego_SE3_camera.rotation)
                for found, into in zip(angles_deg(turns, true, traversals), (relative, whole)):
                    into.append(found)
                with_lenses = adjust_rigs(with_exact_lenses(rigs, matched.drives), matched.tracks, _EXACT_LENSES)
                exact_turns = matrix_from_quaternion(with_lenses.ego_SE3_camera.rotation)
                exact.append(angles_deg(exact_turns, true, traversals)[0])
                start_turns = matrix_from_quaternion(rigs.ego_SE3_camera.rotation)
                before.append(angles_deg(start_turns, true, traversals)[0])
                cover.append(is_covered(adjusted, true).ravel())
                has_peer = traversals == 1 and all(camera.model != "f_theta" for camera in rigs.cameras)
                if draw < _PEER_DRAWS and has_peer:
                    start = time.process_time()
                    other = adjust_with_pycolmap(rigs, adjusted.tracks)
                    other_times.append(time.process_time() - start)
                    others.append(angles_deg(other, true)[0])
            counts = "+".join(str(len(drive.instants_ns)) for drive in matched.drives)
            size = f"{counts} x {len(true) // traversals}, {draws} draws"
            rms = np.sqrt(np.mean(np.square(relative), axis=0))
            every.setdefault(light, []).append(rms)
            peers: tuple[Peer, ...] = ()
            if others:
                peer_rms = np.sqrt(np.mean(np.square(others), axis=0))
                peers = (
                    Peer("pycolmap", 1e3 * float(np.median(other_times)), float(np.median(peer_rms))),
                    Peer("its worst camera", 1e3 * float(np.max(other_times)), float(peer_rms.max())),
                )
            yield Row(
                f"{light}, {vehicle}: adjustment; rms angle to the reference camera, median", size,
                1e3 * float(np.max(times)), float(np.median(rms)), peers, "deg", 1e3 * _ADJUST_S, _MEDIAN_DEG,
            )  # fmt: skip
            yield Row(f"{light}, {vehicle}: worst camera (deg)", size, float(rms.max()), float(np.median(before)),
                      unit="deg before", bar=_WORST_DEG)  # fmt: skip
            angle = np.sqrt(np.mean(np.square(whole), axis=0))
            yield Row(f"{light}, {vehicle}: rms angle to the vehicle, median (deg)", size, float(np.median(angle)),
                      float(angle.max()), unit="deg worst")  # fmt: skip
            exact_rms = np.sqrt(np.mean(np.square(exact), axis=0))
            yield Row(f"{light}, {vehicle}: with exact lenses, rms angle to the reference camera, median (deg)", size,
                      float(np.median(exact_rms)), float(exact_rms.max()), unit="deg worst")  # fmt: skip
            yield Row(f"{light}, {vehicle}: features and matches", size,
                      1e3 * (matched.features_s + matched.matches_s))  # fmt: skip
    for light, of_rigs in every.items():
        rms = np.concatenate(of_rigs)
        yield Row(f"{light}: all rigs, rms angle to the reference camera, median (deg)", f"{len(rms)} cameras",
                  float(np.median(rms)), float(rms.max()), unit="deg worst", bar=_MEDIAN_DEG,
                  error_bar=_WORST_DEG)  # fmt: skip
    inside = np.concatenate(cover)
    yield Row("95 % intervals to the vehicle miss (share)", f"{len(inside)} trials", float(1 - inside.mean()), bar=0.1)
