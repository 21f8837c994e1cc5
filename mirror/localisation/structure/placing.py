"""Gives a part of a map its scale and world, and makes the recording of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.calibration.refinement.features import find_features
from mirror.calibration.tracking import TrackedImage
from mirror.errors import UsageError
from mirror.geometry import (
    Poses,
    interpolate,
    matrix_from_quaternion,
    quaternion_exp,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_log,
    quaternion_multiply,
    rotate,
)
from mirror.geometry.poses import COLUMNS, to_pose_numbers
from mirror.localisation.structure.inputs import DriveInputs
from mirror.localisation.structure.maps import ImageMap, read_poses
from mirror.localisation.structure.prior_adjustment import adjust_to_track
from mirror.localisation.structure.report import PartReport, describe_part
from mirror.localisation.structure.rig_adjustment import adjust_rig
from mirror.localisation.structure.rig_scale import OtherCamera, RigScale, scale_from_rig
from mirror.localisation.structure.road import RoadHeight, mean_up, measure_road, mounting_rotation
from mirror.localisation.structure.road_sweep import GreyImage, sweep_road
from mirror.localisation.structure.similarity import LEAST_FIXES, Similarity, fit_flat, fit_track, rotation_between
from mirror.localisation.structure.track_fixes import TrackFixes
from mirror.localisation.structure.used_images import StaticPixels, UsedImages, mid_exposure_ns, read_grey
from mirror.progress import ProgressReporter
from mirror.recordings.assembly.derived import DerivedRecording
from mirror.recordings.calibration import Calibration, Stage, to_calibration
from mirror.recordings.protocol import Track
from mirror.recordings.time import SECOND_NS

_SAME_ERROR_S: Final = 10.0
"""Fixes share their errors for about this time."""
_OTHER_IMAGES: Final = 40
_RIG_ROUNDS: Final = 1


class PartPlacer:
    """The scales and worlds of the parts of one drive."""

    def __init__(self, inputs: DriveInputs, progress: ProgressReporter) -> None:
        self.inputs, self.options, self.progress = inputs, inputs.options, progress

    def place(self, images: UsedImages, part: ImageMap, name: str, folder: Path) -> tuple[DerivedRecording, PartReport]:
        """Give a part its scale and world.

        Args:
            images: the used images.
            part: the part of a map.
            name: id of the drive of the part.
            folder: folder of its recording, for the report.

        Returns:
            The recording to write, and the report.

        Raises:
            UsageError: the scale, or the height of a camera of unknown mounting, cannot be found.
        """
        recorded, rig = self.inputs.camera.ego_SE3_camera, None
        if self.inputs.scale == "rig":
            others = self._other_cameras(images, part)
            for _ in range(_RIG_ROUNDS):
                # The map has metres from here on; errors of the mountings are found again in the better map.
                rig = scale_from_rig(images, part, self._mounting(), others)
                part = adjust_rig(images, part, rig.scale, rig.seen)
        if recorded is None:
            turn = mounting_rotation(part.world_SE3_camera)
        else:
            turn = matrix_from_quaternion(recorded.rotation)[0]
        up = mean_up(part.world_SE3_camera, turn)
        seen = np.unique(np.concatenate([points for points, _ in part.observed]))
        road = measure_road(part.world_SE3_camera, up, part.points[seen])
        if road is None:
            road = self._sweep_road(images, part, up)
        stamps = images.time_ns[part.used]
        scale, words, sigma = self._find_scale(images, part, road, rig)
        mounting = recorded
        if mounting is None:
            height = self._camera_height(images, part, road, scale, up)
            mounting = Poses(quaternion_from_matrix(turn[None]), np.array([[0.0, 0.0, height]]))
        level = Similarity(scale, rotation_between(up, np.array([0.0, 0.0, 1.0])), np.zeros(3))
        placed, adjusted = self._lay_on_track(part, stamps, up, mounting), None
        if self.inputs.scale == "track" and placed is not None and self.inputs.fixes is not None:
            level, sigma = placed.similarity, placed.sigma_percent
            cameras, adjusted = self._adjust(part, self.inputs.fixes, level, stamps, mounting)
            ego = cameras @ _repeat(mounting.inverse(), len(stamps))
        else:
            # World: z up, its origin at the first pose of the vehicle.
            ego = level.move_poses(part.world_SE3_camera) @ _repeat(mounting.inverse(), len(stamps))
            ego = Poses(ego.rotation, ego.translation - ego.translation[0])
        report = PartReport(
            recording=folder,
            images=len(part.used),
            first_ns=int(stamps[0]),
            last_ns=int(stamps[-1]),
            way_m=float(np.linalg.norm(np.diff(ego.translation, axis=0), axis=1).sum()),
            residual_px=part.residual_px,
            points=len(seen),
            scale=words,
            scale_sigma_percent=sigma,
            lens=self._lens_words(part),
            mounting="recorded" if recorded is not None else "from the direction of travel, no roll, above the road",
            camera_height_m=None if road is None else road.height * level.scale,
            track_rms_m=None if placed is None else placed.rms_m,
            adjusted_rms_m=adjusted,
            track_end_m=None if placed is None else placed.end_m,
        )
        track = self._to_track(ego, stamps)
        return self._derive(images, part, name, track, mounting, recorded is not None), report

    def _find_scale(
        self, images: UsedImages, part: ImageMap, road: RoadHeight | None, rig: RigScale | None
    ) -> tuple[float, str, float | None]:
        """Return metres per unit (0: the track gives them), the source in words, and its 1-sigma in percent."""
        options = self.options
        if self.inputs.scale == "track":
            return 0.0, "fixes of the track", None
        if self.inputs.scale == "length":
            places = part.world_SE3_camera.translation
            way = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
            return (options.length_m or 0.0) / way, f"given length of {options.length_m} m", None
        if rig is not None:
            rays = ", ".join(f"{count} of {name}" for name, count in rig.rays.items())
            return 1.0, f"rig: rays of other cameras: {rays}", rig.sigma_percent
        height = options.camera_height_m
        words = f"given height of the camera, {height} m"
        if height is None:
            height = float(self._mounting().translation[0, 2])
            words = f"recorded height of the camera, {height:.3g} m"
        if road is None or not height > 0.0:
            raise UsageError(
                f"the height of the camera above the road could not be measured ({describe_part(images, part)})",
                file=self.inputs.source, place="--scale height",
                expected="points on the road that the vehicle drives over, and a height above 0",
                remedy="give --length-m METRES, or images in which the road ahead is seen",
            )  # fmt: skip
        return height / road.height, f"{words}, {road.points} points of the road", 100.0 * road.sigma / road.height

    def _mounting(self) -> Poses:
        if self.inputs.camera.ego_SE3_camera is None:
            raise UsageError(
                "the mounting of the camera is not recorded", file=self.inputs.source,
                place=f"--scale {self.inputs.scale}", expected="a calibrated camera",
                remedy="give --camera-height-m METRES",
            )  # fmt: skip
        return self.inputs.camera.ego_SE3_camera

    def _camera_height(
        self, images: UsedImages, part: ImageMap, road: RoadHeight | None, scale: float, up: Float64
    ) -> float:
        """Return the height of a camera of unknown mounting above the road, metres."""
        if self.options.camera_height_m is not None:
            return self.options.camera_height_m
        if road is None:
            raise UsageError(
                f"the height of the camera above the road could not be measured ({describe_part(images, part)})",
                file=self.inputs.source, place=f"camera {self.inputs.camera.info.name}",
                expected="points on the road that the vehicle drives over", remedy="give --camera-height-m METRES",
            )  # fmt: skip
        if scale > 0.0:
            return road.height * scale
        # The height moves the whole way up or down only: the scale does not depend on it.
        level = Poses(quaternion_from_matrix(mounting_rotation(part.world_SE3_camera)[None]), np.zeros((1, 3)))
        placed = self._lay_on_track(part, images.time_ns[part.used], up, level)
        return road.height * placed.similarity.scale if placed is not None else road.height

    def _sweep_road(self, images: UsedImages, part: ImageMap, up: Float64) -> RoadHeight | None:
        """Measure the road where its features are too few, in the images themselves."""
        camera = self.inputs.camera
        mounted = None
        if camera.lens is not None and camera.ego_SE3_camera is not None:
            mounted = camera.lens, camera.ego_SE3_camera
        still = StaticPixels(self.inputs.recording, camera.info, mounted, self.options.masks)
        stream = self.inputs.streams[camera.info.name]

        def read(row: int) -> GreyImage:
            index = int(images.index[part.used[row]])
            ((_, data),) = stream.read([index])
            grey = read_grey(data, f"camera {camera.info.name}, image {index}")
            return grey, still.mark_static(int(images.time_ns[part.used[row]]), grey.shape)

        return sweep_road(part.world_SE3_camera, up, part.lens, read)

    def _other_cameras(self, images: UsedImages, part: ImageMap) -> list[OtherCamera]:
        """Read images of the other cameras, evenly over the part."""
        stamps, found = images.time_ns[part.used], []
        others = [one for one in self.inputs.cameras.values() if one.info.name != self.inputs.camera.info.name]
        for one in others:
            if one.lens is None or one.ego_SE3_camera is None or one.info.name not in self.inputs.streams:
                continue
            stream = self.inputs.streams[one.info.name]
            time_ns = mid_exposure_ns(stream)
            inside = np.flatnonzero((time_ns >= stamps[0]) & (time_ns <= stamps[-1]))
            chosen = inside[:: max(1, len(inside) // _OTHER_IMAGES)]
            still = StaticPixels(self.inputs.recording, one.info, (one.lens, one.ego_SE3_camera), None)
            self.progress.start(f"{self.inputs.source.name}: {one.info.name}", len(chosen))
            features = []
            for index, data in stream.read(chosen.tolist()):
                grey = read_grey(data, f"camera {one.info.name}, image {index}")
                static = still.mark_static(int(time_ns[index]), grey.shape)
                features.append(find_features(TrackedImage.from_grey(grey, static), self.options.features))
                self.progress.advance(1)
            sigma = float(np.hypot(one.sigma_deg, self.inputs.camera.sigma_deg))
            found.append(OtherCamera(one.info.name, one.lens, one.ego_SE3_camera, sigma, time_ns[chosen], features))
        return found

    def _lay_on_track(self, part: ImageMap, stamps: Int64, up: Float64, mounting: Poses) -> _Placed | None:
        """Fit a part to the fixes within it; None: they are too few, and the scale comes from elsewhere."""
        if self.inputs.fixes is None:
            return None
        own = np.flatnonzero((self.inputs.fixes.time_ns >= stamps[0]) & (self.inputs.fixes.time_ns <= stamps[-1]))
        # The ego's position in the map needs the scale of the lever; it is found in two rounds.
        between = interpolate(stamps, part.world_SE3_camera, self.inputs.fixes.time_ns[own])
        lever = mounting.inverse().translation[0]
        turns = matrix_from_quaternion(between.rotation)
        fixes, sigma = self.inputs.fixes.places[own], self.inputs.fixes.sigma_m[own]
        scale, fit = np.inf, None
        try:
            for _ in range(3):
                fit = fit_track(between.translation + turns @ lever / scale, up, fixes, sigma)
                scale = fit.similarity.scale
        except UsageError:
            if self.inputs.scale == "track":
                raise
            return None
        if fit is None:
            return None
        places = between.translation + turns @ lever / scale
        third = max(LEAST_FIXES, len(own) // 3)
        end = None
        if len(own) >= 2 * third:
            flat = fit.similarity.move(places)
            start = fit_flat(flat[:third], fixes[:third, :2], sigma[:third])
            end = float(np.median(np.linalg.norm((start.move(flat) - fixes)[-third // 3 :, :2], axis=1)))
        rms = float(np.sqrt((fit.distance_m**2).mean()))
        sigma_percent = fit.sigma_percent * float(np.sqrt(_shared(self.inputs.fixes.time_ns[own])))
        return _Placed(fit.similarity, sigma_percent, rms, end)

    def _adjust(
        self, part: ImageMap, fixes: TrackFixes, level: Similarity, stamps: Int64, mounting: Poses
    ) -> tuple[Poses, float]:
        """Adjust a part to the track; return the poses of the camera and the distance from the fixes, rms."""
        import pycolmap

        # Parts of one map share its reconstruction.
        reconstruction = pycolmap.Reconstruction(part.reconstruction)
        reconstruction.transform(pycolmap.Sim3d(level.scale, pycolmap.Rotation3d(level.turn), level.shift))
        back = _repeat(mounting.inverse(), len(stamps))
        places, known = fixes.at(stamps)
        turns = matrix_from_quaternion((level.move_poses(part.world_SE3_camera) @ back).rotation)
        towards = places + turns @ mounting.translation[0]
        sigma = fixes.sigma_at(stamps) * np.sqrt(_shared(stamps))
        adjust_to_track(reconstruction, part.used[known], towards[known], sigma[known])
        cameras = keep_roll(level.move_poses(part.world_SE3_camera), read_poses(reconstruction, part.used.tolist()))
        own = np.flatnonzero((fixes.time_ns >= stamps[0]) & (fixes.time_ns <= stamps[-1]))
        ego = interpolate(stamps, cameras @ back, fixes.time_ns[own])
        off = np.linalg.norm((ego.translation - fixes.places[own])[:, :2], axis=1)
        return cameras, float(np.sqrt((off**2).mean()))

    def _to_track(self, ego: Poses, stamps: Int64) -> Track:
        if self.inputs.scale == "track" and self.inputs.fixes is not None and self.inputs.fixes.frame is not None:
            longitude, latitude, height = self.inputs.fixes.frame.to_geodetic(ego.translation)
            local = self.inputs.fixes.frame.world_R_enu(longitude, latitude)
            turns = np.swapaxes(local, 1, 2) @ matrix_from_quaternion(ego.rotation)
            return Track(stamps, longitude, latitude, height_m=height, rotation=quaternion_from_matrix(turns))
        x, y, z = ego.translation.T
        return Track(stamps, x_m=x, y_m=y, height_m=z, rotation=ego.rotation)

    def _lens_words(self, part: ImageMap) -> str:
        lens = part.lens
        if self.inputs.camera.lens is not None:
            return "given" if self.options.lens is not None else "recorded"
        return f"estimated: focal length {lens.fx_px:.1f} px, k1 {lens.distortion[0]:.4f}"

    def _derive(
        self, images: UsedImages, part: ImageMap, name: str, track: Track, mounting: Poses, is_known: bool
    ) -> DerivedRecording:
        info, stamps = self.inputs.recording.info, images.time_ns[part.used]
        local = track.longitude_deg is None
        kept_frame = self.inputs.fixes is not None and self.inputs.scale == "track" and local
        frame = info.frame if kept_frame else name if local else None
        indices: dict[str, Int64] = {}
        for camera, stream in self.inputs.streams.items():
            time_ns = mid_exposure_ns(stream)
            indices[camera] = np.flatnonzero((time_ns >= stamps[0]) & (time_ns <= stamps[-1])).astype(np.int64)
        indices[self.inputs.camera.info.name] = images.index[part.used]
        boxes = self.inputs.recording.boxes()
        if boxes is not None:
            when = boxes["timestamp_ns"].to_numpy()
            boxes = boxes.filter((when >= stamps[0]) & (when <= stamps[-1]))
        drive = replace(info, drive_id=name, frame=frame, body_frame="ego")
        return DerivedRecording(
            drive,
            self.inputs.rig,
            track,
            self.inputs.streams,
            indices,
            self._calibrations(part, mounting, is_known),
            boxes,
            {},
        )

    def _calibrations(self, part: ImageMap, mounting: Poses, is_known: bool) -> list[tuple[Stage, Calibration]]:
        found: list[tuple[Stage, Calibration]] = []
        own = self.inputs.camera.info.name
        replaced = not is_known or self.options.lens is not None or self.inputs.camera.lens is None
        for row in self.inputs.recording.calibrations().to_pylist():
            if not (replaced and row["camera"] == own):
                found.append((row["stage"], _to_calibration(row)))
        if replaced:
            lens = "given lens" if self.inputs.camera.lens is not None else "lens estimated"
            method = f"structure from motion: {lens}, mounting {'recorded' if is_known else 'from the way'}"
            found.append(("factory", to_calibration(own, part.lens, to_pose_numbers(mounting), method)))
        return found


@dataclass(frozen=True, eq=False)
class _Placed:
    """A part that was laid on a track."""

    similarity: Similarity
    sigma_percent: float
    rms_m: float
    end_m: float | None


def _to_calibration(row: Mapping[str, Any]) -> Calibration:
    names = set(Calibration.model_fields) - {"ego_SE3_camera"}
    plain = {name: row[name] for name in names if name in row}
    return Calibration(**plain, ego_SE3_camera=tuple(row[name] for name in COLUMNS))


def keep_roll(before: Poses, after: Poses) -> Poses:
    """Turn poses back about their way, so that their mean roll is that of other poses.

    Positions on a straight way do not hold the roll about it: an adjustment to them turns it to fit their noise.

    Args:
        before: N poses with the roll to keep.
        after: N poses.
    """
    middle = after.translation.mean(axis=0)
    axis = np.linalg.svd(after.translation - middle)[2][0]
    turns = quaternion_log(quaternion_multiply(before.rotation, quaternion_inverse(after.rotation)))
    back = quaternion_exp((axis * float(axis @ turns.mean(axis=0)))[None])
    about = Poses(back, middle[None] - rotate(back, middle[None]))
    return _repeat(about, len(after)) @ after


def _repeat(pose: Poses, count: int) -> Poses:
    return pose[np.zeros(count, np.int64)]


def _shared(time_ns: Int64) -> int:
    """Return the largest number of times that share the errors of fixes."""
    return int((np.searchsorted(time_ns, time_ns + int(_SAME_ERROR_S * SECOND_NS)) - np.arange(len(time_ns))).max())
