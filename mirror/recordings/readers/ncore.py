"""NVIDIA NCore V4: sequences of component stores, with any cameras, rolling shutters and boxes.

Facts of the format, from the specification that it publishes (docs/data/conventions and formats):

- A sequence is one or more stores ``<name>.ncore4[-<group>].zarr.itar`` (an indexed tar file) or ``.zarr`` (a folder).
- Poses form a tree of named frames; ``T_a_b`` maps points of a into b. ``rig`` is x forward, y left, z up, in the
  middle of the rear axle on the ground. ``world`` is the first pose of the vehicle; ``world_global`` is earth-centred,
  earth-fixed, but converters of sources without a place put another frame there.
- Cameras are x right, y down, z forward; the image's corner is at (0, 0). Frames state start and end of their exposure.
- Boxes are in the frame of a sensor at a stamp, and describe a stamp of their own.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.geometry.quaternions import quaternion_exp, quaternion_multiply
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import track_from_ecef
from mirror.recordings.opening import require_file
from mirror.recordings.paths import list_files, require_inside, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, RigInfo, Track
from mirror.recordings.readers.box_rows import make_box_table
from mirror.recordings.readers.collection import choose_drive
from mirror.recordings.readers.ncore_lenses import SHUTTERS, to_camera
from mirror.recordings.readers.ncore_store import NcoreStores
from mirror.recordings.readers.stored_poses import (
    REMEDY,
    is_no_rigid_motion,
    mark_matrices,
    poses_at,
    require_poses,
    select_poses,
    to_poses,
)
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults

_STORE: Final = re.compile(r"(.+)\.ncore4(?:-[^.]+)?\.zarr(?:\.itar)?")
_METADATA: Final = ".zmetadata.cbor.xz"
_RIG: Final = "rig"
_WORLD: Final = "world"
_GLOBAL: Final = "world_global"
_COMPONENTS: Final = ("poses", "intrinsics", "masks", "cuboids")
# Distances from the centre of the earth at which roads lie, with a wide margin.
_SURFACE_M: Final = (6.33e6, 6.40e6)
_LONGEST_US: Final = 9_000_000_000_000_000


class NcoreReader:
    """A reader of the sequences of a folder of NCore stores; each is a drive with the path ``FOLDER/NAME``."""

    name = "ncore"
    expects = "a folder with NAME.ncore4*.zarr.itar or NAME.ncore4*.zarr, or FOLDER/NAME"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder holds stores."""
        return path.is_dir() and any(_STORE.fullmatch(child.name) for child in path.iterdir())

    def drives(self, path: Path) -> Sequence[str]:
        """Return the names of the sequences that have stores in the folder."""
        return sorted({match[1] for child in path.iterdir() if (match := _STORE.fullmatch(child.name))})

    def open(self, path: Path, options: Mapping[str, str]) -> NcoreRecording:
        """Open a sequence.

        Options: ``cameras`` names the cameras to read, with commas between them; ``frame`` names the local frame of
        sequences without a place on the globe that share their world; ``poses``, ``intrinsics``, ``masks`` and
        ``cuboids`` name the instance of a component if a sequence has several.
        """
        refuse_options(options, ("cameras", "frame", *_COMPONENTS), path, self.name)
        root, name = (path, None) if self.recognises(path) else (path.parent, path.name)
        if not root.is_dir() or not self.recognises(root):
            raise RecordingError("no stores of NCore V4", file=path, expected=self.expects)
        drive = choose_drive(self.drives(root), name, root)
        frame, cameras = options.get("frame"), options.get("cameras")
        return NcoreRecording(
            root,
            drive,
            frame=to_identifier(frame) if frame else None,
            chosen=tuple(word.strip() for word in cameras.split(",")) if cameras else None,
            instances={name: options[name] for name in _COMPONENTS if name in options},
        )


@dataclass(frozen=True)
class NcoreRecording:
    """One sequence of NCore stores.

    Attributes:
        root: the folder of the stores.
        drive: the name before ``.ncore4``.
        frame: name of the local frame; None: the sequence has a frame of its own.
        chosen: the cameras to read; None: all.
        instances: names of component instances.
    """

    root: Path
    drive: str
    frame: str | None = None
    chosen: tuple[str, ...] | None = None
    instances: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def _listed(self) -> tuple[tuple[Path, ...], list[tuple[str, Path]]]:
        """The stores, and the files in them that are read; none leads out of the folder."""
        stores, files = [], []
        for path in sorted(self.root.iterdir()):
            match = _STORE.fullmatch(path.name)
            if match is None or match[1] != self.drive:
                continue
            stores.append(path)
            if path.name.endswith(".itar"):
                files.append((path.name, require_file(self.root, path.name)))
                continue
            require_inside(self.root, path.name, file=path, place="store")
            files.append((f"{path.name}/{_METADATA}", require_file(self.root, f"{path.name}/{_METADATA}")))
            files += [(f"{path.name}/{name}", Path(file)) for name, file in list_files(path)]
        return tuple(stores), files

    @cached_property
    def _stores(self) -> NcoreStores:
        return NcoreStores(self._listed[0], self.instances)

    @cached_property
    def _global(self) -> Poses | None:
        """``global_SE3_world``, or None."""
        matrix = self._stores.static_poses.get((_WORLD, _GLOBAL))
        if matrix is None:
            return None
        self._require_rigid(matrix, f"the pose of {_WORLD} in {_GLOBAL}")
        return to_poses(matrix[None])

    @property
    def _is_geodetic(self) -> bool:
        """Return whether the global frame is earth-centred, earth-fixed."""
        pose = self._global
        return pose is not None and _SURFACE_M[0] < float(np.linalg.norm(pose.translation[0])) < _SURFACE_M[1]

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; ids come from the sequence's id, and the format states neither vehicle nor conditions."""
        name = to_identifier(f"ncore_{self._stores.sequence_id}")
        return DriveInfo(
            drive_id=name,
            vehicle_id="ncore",
            vehicle_type="unknown",
            time_base="Unix microseconds",
            frame=None if self._is_geodetic else self.frame or name,
        )

    @cached_property
    def _cameras(self) -> dict[str, str]:
        """Names by the sequence's names of the cameras that have images."""
        frames = self._stores.frames_us
        missing = sorted(set(self.chosen or ()) - set(frames))
        if missing:
            raise RecordingError(
                f"the sequence has no images of the camera {missing[0]!r:.80}",
                file=self.root / self.drive,
                place="option cameras",
                expected=f"one or more of {', '.join(frames)}",
            )
        names = {source: to_identifier(source) for source in frames if self.chosen is None or source in self.chosen}
        if len(set(names.values())) < len(names):
            raise RecordingError(
                "two cameras have the same name without their special characters",
                file=self.root / self.drive,
                expected="camera names of letters, digits, '_' and '-'",
            )
        return names

    @cached_property
    def rig(self) -> RigInfo | None:
        """The cameras that have images; the reference camera is a front camera if there is one."""
        names = self._cameras
        if not names:
            return None
        cameras = tuple(CameraInfo(name, source, self._stores.ego_mask(source)) for source, name in names.items())
        front = [name for name in names.values() if "front" in name]
        reference = min(front, key=lambda name: ("wide" not in name, name)) if front else min(names.values())
        return RigInfo(to_identifier("ncore_" + "_".join(sorted(names.values()))), cameras, reference)

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the stores; for a store that is a folder, its metadata and arrays."""
        return sorted(self._listed[1])

    def track(self) -> Track:
        """Return the vehicle's poses, on WGS 84 if the sequence states its place."""
        file = self._stores.poses_path
        stamp_us, matrix = self._stores.trajectory(_RIG, _WORLD)
        known = stamp_us <= _LONGEST_US
        poses, bad = mark_matrices(matrix)

        def error(row: int) -> RecordingError:
            return RecordingError(
                f"{matrix[row].tolist()} at {stamp_us[row]} us is no pose",
                file=file,
                place=f"pose {row} of {_RIG} in {_WORLD}",
                expected="a stamp and a rigid 4x4 matrix",
                remedy=REMEDY,
            )

        faults = RowFaults(len(stamp_us))
        faults.add(~known, "time", error)
        faults.add(bad, "rotation", error)
        if self._global is not None:
            poses = self._global @ poses
        stamp_ns: Int64 = np.where(known, stamp_us, 0) * 1_000
        if self._is_geodetic:
            track = track_from_ecef(stamp_ns, poses.translation, poses.rotation, file=file, faults=faults)
            return faults.drop_from(track)
        x, y, z = poses.translation.T
        return faults.drop_from(Track(stamp_ns, x_m=x, y_m=y, height_m=z, rotation=poses.rotation, file=file))

    def calibrations(self) -> pa.Table:
        """Return the cameras that have images, with the direction and duration of their shutters."""
        calibrations: list[tuple[Stage, Calibration]] = []
        for source, name in self._cameras.items():
            file, lens = self._stores.lens(source)
            camera, method = to_camera(lens, file, source)
            mounting = self._static_path(source, _RIG)
            if mounting is None:
                raise RecordingError(
                    f"the camera {source!r:.80} has no fixed place on the vehicle",
                    file=self._stores.poses_path,
                    expected=f"static poses that lead from it to {_RIG}",
                    remedy="read the other cameras alone: --option cameras=NAME,NAME",
                )
            direction = SHUTTERS[lens.shutter_type.name]
            frames = self._stores.frames_us[source]
            readout_us = 0 if direction == "global" else float(np.median(frames[:, 1] - frames[:, 0]))
            calibration = make_calibration(
                file,
                name,
                **camera.to_row(),
                ego_SE3_camera=to_pose_numbers(mounting),
                shutter_direction=direction,
                readout_ns=round(readout_us * 1_000),
                method=f"NCore {method}",
            )
            calibrations.append(("factory", calibration))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return the images of each camera, read from the stores; a frame's start and end are taken as its exposure."""
        streams: dict[str, ImageStream] = {}
        for source, name in self._cameras.items():
            frames = self._stores.frames_us[source]
            codec = self._stores.image_format(source, int(frames[0, 1]))
            streams[name] = _StoreStream(name, codec, frames[:, 0] * 1_000, frames[:, 1] * 1_000, source, self._stores)
        return streams

    def boxes(self) -> pa.Table | None:
        """Return the cuboids in the vehicle's frame at their own stamps; None if the sequence has none."""
        seen = self._stores.observations()
        if not seen:
            return None
        file = self._stores.cuboids_path()
        values = np.stack([one.box for one in seen])
        stamps, frame_us = (
            np.array([getattr(one, name) for one in seen], np.float64) for name in ("timestamp_us", "frame_us")
        )
        if not ((np.abs(stamps) <= _LONGEST_US) & (np.abs(frame_us) <= _LONGEST_US)).all():
            raise RecordingError("a box without a stamp", file=file, expected="Unix microseconds", remedy=REMEDY)
        axes = np.eye(3)
        with np.errstate(all="ignore"):
            about = [quaternion_exp(np.outer(values[:, 6 + axis], axes[axis])) for axis in range(3)]
            rotation = quaternion_multiply(about[2], quaternion_multiply(about[1], about[0]))
        frame_SE3_box = require_poses(rotation, values[:, :3], file=file, place="cuboid {}".format)
        ego_SE3_box = self._to_ego([one.frame for one in seen], frame_us, stamps, frame_SE3_box, file)
        columns = {
            "timestamp_ns": stamps.astype(np.int64) * 1_000,
            "track_id": [one.track_id for one in seen],
            "category": [one.class_id for one in seen],
            "source": [f"ncore_{one.source}" for one in seen],
            "source_version": [to_identifier(one.version) for one in seen],
        }
        return make_box_table(ego_SE3_box, values[:, 3:6], columns)

    def _to_ego(
        self, frames: Sequence[str], frame_us: Float64, stamps: Float64, frame_SE3_box: Poses, file: Path
    ) -> Poses:
        """Boxes in the ego's frame at their own stamps: through the world where frame and box differ in time."""
        rotation, translation = np.empty((len(frames), 4)), np.empty((len(frames), 3))
        for frame in sorted(set(frames)):
            rows = np.flatnonzero(np.array(frames) == frame)
            boxes, at, own = frame_SE3_box[rows], frame_us[rows].astype(np.int64), stamps[rows].astype(np.int64)
            on_rig, in_world = self._static_path(frame, _RIG), self._static_path(frame, _WORLD)
            if on_rig is not None:
                moved = on_rig @ boxes
                late = at != own
                if late.any():
                    through = self._rig_at(own).inverse() @ self._rig_at(at) @ moved
                    moved = Poses(
                        np.where(late[:, None], through.rotation, moved.rotation),
                        np.where(late[:, None], through.translation, moved.translation),
                    )
            elif in_world is not None:
                moved = self._rig_at(own).inverse() @ in_world @ boxes
            else:
                raise RecordingError(
                    f"boxes in the frame {frame!r:.80}, which no static pose leads from to {_RIG} or {_WORLD}",
                    file=file,
                    expected="the frame of a sensor, the rig or the world",
                    remedy=REMEDY,
                )
            rotation[rows], translation[rows] = moved.rotation, moved.translation
        return Poses(rotation, translation)

    @cached_property
    def _trajectory(self) -> tuple[Int64, Poses]:
        stamp_us, matrix = self._stores.trajectory(_RIG, _WORLD)
        good = (stamp_us <= _LONGEST_US) & ~is_no_rigid_motion(matrix)
        times, rows = select_poses(stamp_us, good, self._stores.poses_path)
        return times, to_poses(matrix[rows])

    def _rig_at(self, stamps_us: Int64) -> Poses:
        """``world_SE3_rig``; a stamp before the first or after the last pose has that pose."""
        return poses_at(stamps_us, *self._trajectory)

    def _static_path(self, source: str, target: str) -> Poses | None:
        """``target_SE3_source`` along static poses; None: none leads there."""
        edges = self._stores.static_poses
        reached = {source: np.eye(4)}
        waiting = deque([source])
        while waiting and target not in reached:
            here = waiting.popleft()
            for (start, end), matrix in edges.items():
                if here not in (start, end):
                    continue
                there = end if here == start else start
                if there in reached:
                    continue
                self._require_rigid(matrix, f"the pose of {start} in {end}")
                step = matrix if here == start else np.linalg.inv(matrix)
                reached[there] = step @ reached[here]
                waiting.append(there)
        return to_poses(reached[target][None]) if target in reached else None

    def _require_rigid(self, matrix: Float64, what: str) -> None:
        if is_no_rigid_motion(matrix[None])[0]:
            raise RecordingError(
                f"{what} is no rigid motion: {matrix.tolist()}",
                file=self._stores.poses_path,
                expected="a rigid 4x4 matrix",
                remedy=REMEDY,
            )


@dataclass(frozen=True)
class _StoreStream:
    """Images in the stores of a sequence."""

    camera: str
    codec: str
    exposure_start_ns: Int64
    exposure_end_ns: Int64
    source: str
    stores: NcoreStores = field(repr=False)

    def path(self, index: int) -> None:
        """None: the images lie in stores."""

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield the bytes of images as they are stored."""
        for index in indices:
            end_us = int(self.exposure_end_ns[index]) // 1_000
            if self.stores.image_format(self.source, end_us) != self.codec:
                raise RecordingError(
                    f"not {self.codec}, as the first image of the camera is",
                    file=self.stores.camera_path(self.source),
                    place=f"camera {self.source}, frame {end_us}",
                )
            yield index, self.stores.image(self.source, end_us)
