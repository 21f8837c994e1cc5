"""A drive in message logs: poses from fixes, odometry or transforms; images, intrinsics and mountings by topic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64, UInt8
from mirror.errors import RecordingError
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.geometry.quaternions import quaternion_multiply, quaternion_normalise
from mirror.recordings.calibration import (
    Calibration,
    Stage,
    make_calibration,
    to_calibration,
    to_calibration_table,
)
from mirror.recordings.coordinates import is_invalid_rotation, to_ego_track
from mirror.recordings.lens_files import read_lens
from mirror.recordings.mounting import mounting_pose
from mirror.recordings.paths import require_inside, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, RigInfo, Track, choose_reference_camera
from mirror.recordings.readers.message_logs.container import MessageLog
from mirror.recordings.readers.message_logs.contents import CameraContents, Contents, read_contents
from mirror.recordings.readers.message_logs.decoding import CameraMessage, FixMessage, PoseMessage
from mirror.recordings.readers.message_logs.images import MessageImages, MessageVideo, stored_messages
from mirror.recordings.readers.message_logs.topics_file import TopicsFile
from mirror.recordings.readers.message_logs.zstd import without_suffix
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.static_masks import read_static_mask

# Unix nanoseconds of the year 2000: earlier stamps count from the start of a computer.
_FIRST_CLOCK_NS: Final = 946_684_800_000_000_000
_LAST_CLOCK_NS: Final = 2**63 - 1
_IDENTITY: Final = (1.0, 0.0, 0.0, 0.0)
_LENSES: Final[dict[str, tuple[str, int]]] = {
    "plumb_bob": ("brown_conrady", 5),
    "rational_polynomial": ("rational", 8),
    "equidistant": ("kannala_brandt", 4),
    "fisheye": ("kannala_brandt", 4),
    "kannala_brandt": ("kannala_brandt", 4),
}
"""MIRROR's camera model and the number of its coefficients, by the word of the message."""


@dataclass(frozen=True)
class LogRecording:
    """One drive in one or several log files in sequence."""

    path: Path
    logs: tuple[MessageLog, ...]
    document: TopicsFile
    topics_file: Path

    @cached_property
    def info(self) -> DriveInfo:
        """The entries of the topics file."""
        document = self.document
        return DriveInfo(
            drive_id=document.drive_id or to_identifier(without_suffix(self.path).stem),
            vehicle_id=document.vehicle_id,
            vehicle_type=document.vehicle_type,
            time_base="Unix nanoseconds of the messages"
            if document.stamps == "header"
            else "Unix nanoseconds of logging",
            frame=self._frame,
            body_frame=self._body[0],
            city=document.city,
            weather=document.weather,
            light=document.light,
            licence=document.licence,
        )

    @cached_property
    def _contents(self) -> Contents:
        return read_contents(self.logs, self.document)

    @property
    def rig(self) -> RigInfo | None:
        """The cameras of the topics file; None if it has none."""
        cameras = self.document.cameras
        if not cameras:
            return None
        rig_id = self.document.rig_id or f"rig_{self.document.vehicle_id}"
        infos = tuple(
            CameraInfo(name, entry.images, self._static_mask(name), self._is_calibrated(name))
            for name, entry in cameras.items()
        )
        return RigInfo(rig_id, infos, self.document.reference_camera or choose_reference_camera(tuple(cameras)))

    def _static_mask(self, camera: str) -> UInt8 | None:
        name = self.document.cameras[camera].static_mask
        return read_static_mask(self.topics_file.parent, name, camera, self.topics_file)

    def _is_calibrated(self, camera: str) -> bool:
        """False: the camera has no topic of intrinsics, or all its messages state that it is not calibrated."""
        contents = self._contents.cameras.get(camera)
        if self.document.cameras[camera].lens is not None:
            return True
        if self.document.cameras[camera].info is None:
            return False
        return contents is None or bool(contents.intrinsics) or not contents.declared_uncalibrated

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the logs, the topics file, and the files of lenses and masks that it names."""
        cameras = self.document.cameras.values()
        named = {self._lens_file(entry.lens)[0] for entry in cameras if entry.lens is not None}
        named |= {self.topics_file.parent / entry.static_mask for entry in cameras if entry.static_mask is not None}
        return sorted((file.name, file) for file in (*(log.path for log in self.logs), self.topics_file, *named))

    def _lens_file(self, stated: str) -> tuple[Path, str | None]:
        """The file of a lens, and the camera in it, if one is named."""
        name, _, camera = stated.partition(":")
        return require_inside(self.topics_file.parent, name, file=self.topics_file, place="lens"), camera or None

    @cached_property
    def _is_fix(self) -> bool:
        poses = self._contents.poses
        return bool(poses) and isinstance(poses[0][1], FixMessage)

    @cached_property
    def _frame(self) -> str | None:
        """Name of the local metric frame; None: positions are WGS 84."""
        if self._is_fix:
            return None
        if self.document.pose.frame is not None:
            return self.document.pose.frame
        if self.document.pose.transform is not None:
            return to_identifier(self.document.pose.transform[0])
        return to_identifier(next((pose.header.frame for _, pose in self._contents.poses), "") or "local")

    @cached_property
    def _body(self) -> tuple[str, Poses | None]:
        """The body of the track (``ego`` if its offset is known), and ``ego_SE3_body`` of the recorded poses."""
        ego = self.document.ego_frame
        if self.document.pose.transform is not None:
            return "ego", None
        body = next((self._body_frame(pose) for _, pose in self._contents.poses), "")
        if body in ("", ego):
            return "ego", None
        mounting = self._contents.transforms.mounting(ego, body)
        if mounting is None or (self._is_fix and self.document.pose.orientation is None):
            return to_identifier(body), None
        return "ego", mounting

    def _body_frame(self, pose: FixMessage | PoseMessage) -> str:
        return (pose.header.frame if isinstance(pose, FixMessage) else pose.child).lstrip("/")

    def track(self) -> Track:
        """Return poses, in the ego frame where the body's mounting is known; unreadable messages count as bad rows."""
        if self.document.pose.transform is not None:
            return self._track_of_transforms(*self.document.pose.transform)
        rows = self._contents.poses
        topic = self.document.pose.topic
        if not rows:
            raise RecordingError(
                f"topic {topic} has no messages",
                file=self.path,
                expected="poses or fixes",
                remedy="name another topic in the topics file",
            )
        stamps = self._clock([stamp for stamp, _ in rows], f"topic {topic}")
        faults = RowFaults(len(rows), [(0, error) for error in self._contents.damage], reason="file")
        if self._is_fix:
            return faults.drop_from(self._track_of_fixes(stamps, [fix for _, fix in rows], faults))
        return faults.drop_from(self._track_of_poses(stamps, [pose for _, pose in rows], faults))

    def _track_of_fixes(self, stamps: Int64, fixes: Sequence[FixMessage | PoseMessage], faults: RowFaults) -> Track:
        values = np.array(
            [
                (fix.longitude_deg, fix.latitude_deg, fix.height_m, fix.sigma_m, fix.valid)
                if isinstance(fix, FixMessage)
                else (np.nan,) * 5
                for fix in fixes
            ]
        )
        bad = ~np.isfinite(values[:, :2]).all(axis=1) | (values[:, 4] != 1.0)
        faults.add(bad, "number", lambda row: self._row_error(stamps, row, "the receiver has no position"))
        rotation = None
        if self.document.pose.orientation is not None:
            rotation, unknown = self._turns_at(stamps)
            faults.add(unknown, "rotation", lambda row: self._row_error(stamps, row, "no orientation at this time"))
        height = values[:, 2] if np.isfinite(values[:, 2]).any() else None
        sigma = values[:, 3] if np.isfinite(values[:, 3]).any() else None
        track = Track(
            stamps,
            longitude_deg=np.where(bad, 0.0, values[:, 0]),
            latitude_deg=np.where(bad, 0.0, values[:, 1]),
            height_m=height,
            rotation=rotation,
            sigma_m=sigma,
            file=self.logs[0].path,
        )
        mounting = self._body[1]
        return track if mounting is None else to_ego_track(track, mounting)

    def _turns_at(self, stamps: Int64) -> tuple[Float64, np.ndarray]:
        """``enu_SE3_ego`` rotations (N, 4) at N stamps, and (N,) where there is none."""
        turns = self._contents.turns
        topic = self.document.pose.orientation
        if not turns:
            raise RecordingError(
                f"topic {topic} has no messages",
                file=self.path,
                place="pose.orientation",
                remedy="name another topic, or leave orientation out of the topics file",
            )
        times = self._clock([stamp for stamp, _ in turns], f"topic {topic}")
        rotation = np.array([pose.pose[:4] for _, pose in turns])
        good = ~is_invalid_rotation(rotation)
        times, first = np.unique(times[good], return_index=True)
        if len(times) < 2:
            raise RecordingError(
                f"topic {topic} has {len(times)} orientations",
                file=self.path,
                place="pose.orientation",
                expected="at least two unit quaternions",
                remedy="name another topic, or leave orientation out of the topics file",
            )
        body = turns[0][1].child.lstrip("/")
        mounting = self._contents.transforms.mounting(self.document.ego_frame, body) if body else None
        poses = Poses(rotation[good][first], np.zeros((len(times), 3)))
        unknown = (stamps < times[0]) | (stamps > times[-1])
        found = interpolate(times, poses, np.clip(stamps, times[0], times[-1])).rotation
        if mounting is not None:
            found = quaternion_multiply(found, mounting.inverse().rotation)
        return found, unknown

    def _track_of_poses(self, stamps: Int64, poses: Sequence[FixMessage | PoseMessage], faults: RowFaults) -> Track:
        values = np.array([pose.pose if isinstance(pose, PoseMessage) else (np.nan,) * 7 for pose in poses])
        lost = ~np.isfinite(values[:, 4:]).all(axis=1)
        faults.add(lost, "number", lambda row: self._row_error(stamps, row, "the position is not finite"))
        bad = is_invalid_rotation(values[:, :4])
        faults.add(bad, "rotation", lambda row: self._row_error(stamps, row, "no unit quaternion"))
        rotation = quaternion_normalise(np.where(bad[:, None], _IDENTITY, values[:, :4]))
        x, y, z = np.where(lost[:, None], 0.0, values[:, 4:]).T
        track = Track(stamps, x_m=x, y_m=y, height_m=z, rotation=rotation, file=self.logs[0].path)
        mounting = self._body[1]
        return track if mounting is None else to_ego_track(track, mounting)

    def _track_of_transforms(self, fixed: str, ego: str) -> Track:
        stamps, poses = self._contents.transforms.motion(fixed, ego)
        stamps = self._clock(stamps.tolist(), "the transforms")
        x, y, z = poses.translation.T
        track = Track(stamps, x_m=x, y_m=y, height_m=z, rotation=poses.rotation, file=self.logs[0].path)
        faults = RowFaults(len(track), [(0, error) for error in self._contents.damage], reason="file")
        return faults.drop_from(track)

    def _row_error(self, stamps: Int64, row: int, problem: str) -> RecordingError:
        return RecordingError(
            problem, file=self.path, place=f"topic {self.document.pose.topic}, stamp {stamps[row]}", expected="a pose"
        )

    def _clock(self, stamps: Sequence[int], what: str) -> Int64:
        """Stamps as an array, if they are Unix time.

        Raises:
            RecordingError: they count from another origin, as without a clock.
        """
        if stamps and not _FIRST_CLOCK_NS <= min(stamps) <= max(stamps) <= _LAST_CLOCK_NS:
            raise RecordingError(
                f"{what} has stamps from {min(stamps)} to {max(stamps)} ns, which are no Unix time",
                file=self.path,
                expected="Unix nanoseconds",
                remedy='set stamps = "log" in the topics file if the times of logging are right'
                if self.document.stamps == "header"
                else "record with a clock, or shift the stamps of the log",
            )
        return np.array(stamps, np.int64)

    def calibrations(self) -> pa.Table:
        """Return the intrinsics and mountings of the cameras with a topic of intrinsics.

        A changed lens gives another row.
        """
        found: list[tuple[Stage, Calibration]] = []
        for name, entry in self.document.cameras.items():
            contents = self._contents.cameras.get(name)
            if contents is None or not self._is_calibrated(name):
                continue
            if entry.lens is not None and entry.mounting is not None:
                lens_of_file = read_lens(*self._lens_file(entry.lens))
                found.append(
                    ("factory", to_calibration(name, lens_of_file, mounting_pose(entry.mounting), "lens file"))
                )
                continue
            frame = entry.frame or contents.frame
            transform = self._contents.transforms.mounting(self.document.ego_frame, frame)
            mounting = None if transform is None else to_pose_numbers(transform)
            if entry.mounting is not None:
                mounting = mounting_pose(entry.mounting)
            if mounting is None or not contents.intrinsics:
                raise RecordingError(
                    f"topic {entry.info} has no messages"
                    if mounting is not None
                    else f"no chain of transforms leads from {self.document.ego_frame!r} to {frame!r}",
                    file=self.path,
                    place=f"camera {name}",
                    expected="intrinsics, and a mounting on the vehicle",
                    remedy="correct frame or ego_frame in the topics file, state the camera's mounting there, or leave"
                    " its info out: it is then uncalibrated",
                )
            pose = mounting
            starts = [stamp for stamp, _ in contents.intrinsics]
            for number, (start, lens) in enumerate(contents.intrinsics):
                validity = {
                    "valid_from_ns": start if number else None,
                    "valid_to_ns": starts[number + 1] - 1 if number + 1 < len(starts) else None,
                }
                found.append(("factory", self._calibration(name, lens, pose, validity)))
        return to_calibration_table(found, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def _calibration(
        self, camera: str, lens: CameraMessage, pose: tuple[float, ...], validity: Mapping[str, int | None]
    ) -> Calibration:
        plain = not any(lens.distortion)
        if not plain and lens.model not in _LENSES:
            raise RecordingError(
                f"the distortion model {lens.model!r} is unknown",
                file=self.path,
                place=f"camera {camera}",
                expected=f"one of {', '.join(_LENSES)}",
                remedy="leave the camera's info out of the topics file: the camera is then uncalibrated",
            )
        model, count = ("pinhole", 0) if plain and lens.model not in ("equidistant", "fisheye") else _LENSES[lens.model]
        coefficients = (*lens.distortion, *(0.0,) * count)
        if any(coefficients[max(count, len(lens.distortion)) :]) or any(lens.distortion[count:]):
            raise RecordingError(
                f"{len(lens.distortion)} coefficients of the model {lens.model!r}",
                file=self.path,
                place=f"camera {camera}",
                expected=f"at most {count} that are not zero",
                remedy="leave the camera's info out of the topics file: the camera is then uncalibrated",
            )
        return make_calibration(
            self.path,
            camera,
            model=model,
            width_px=lens.width_px,
            height_px=lens.height_px,
            fx_px=float(lens.K[0, 0]),
            fy_px=float(lens.K[1, 1]),
            # The messages have the centre of the first pixel at 0 (OpenCV).
            cx_px=float(lens.K[0, 2]) + 0.5,
            cy_px=float(lens.K[1, 2]) + 0.5,
            distortion=coefficients[:count],
            ego_SE3_camera=pose,
            method="intrinsics message and transforms of the log",
            **validity,
        )

    def images(self) -> Mapping[str, ImageStream]:
        """Return one stream per camera with images, in the order of stamps.

        Of repeated stamps the first image is kept.
        """
        return {
            name: self._stream(name, contents) for name, contents in self._contents.cameras.items() if contents.places
        }

    def _stream(self, name: str, contents: CameraContents) -> ImageStream:
        every = self._clock(contents.stamps, f"camera {name}")
        stamps, order = np.unique(every, return_index=True)
        repeated = np.sort(np.delete(every, order))
        log = np.array(contents.log, np.int64)
        if contents.format in ("jpeg", "png"):
            stored = stored_messages(self.logs, contents.topic, log, contents.places, order)
            return MessageImages(name, contents.format, stamps, stored, repeated)
        if len(repeated):
            # A frame is decoded from the packets before it: none of them can be left out.
            raise RecordingError(
                f"{len(repeated)} packets of the video have the stamp of another",
                file=self.path,
                place=f"camera {name}, topic {contents.topic.name}, stamp {repeated[0]}",
                expected="one packet for each stamp",
                remedy='set stamps = "log" in the topics file if the times of logging are right, or leave the camera'
                " out of it",
            )
        is_key = np.array(contents.is_key, np.bool_)[order]
        if not is_key.any():
            raise RecordingError(
                "the video has no key frame",
                file=self.path,
                place=f"camera {name}, topic {contents.topic.name}",
                expected="H.264 or H.265 in Annex B format with regular key frames",
                remedy="leave the camera out of the topics file",
            )
        # A log may begin in the middle of a group of frames, which do not decode.
        first = int(np.argmax(is_key))
        stored = stored_messages(self.logs, contents.topic, log, contents.places, order[first:])
        return MessageVideo(name, stamps[first:], stored, is_key[first:], contents.format)

    def boxes(self) -> None:
        """Return None: there is no common message type for 3D boxes."""
