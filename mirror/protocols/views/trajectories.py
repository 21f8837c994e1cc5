"""Trajectories of a vehicle: recorded ones, shifted ones beside or ahead of them, and ones from a file of poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.dataset.dataset import Dataset
from mirror.dataset.image import Image
from mirror.errors import DatasetError, UsageError
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import COLUMNS, Poses
from mirror.protocols.document import Pixels
from mirror.protocols.views.final_camera import final_camera
from mirror.protocols.views.plan import render_path
from mirror.protocols.views.rolling import LineTimes, fit_line_times, make_view_shutter
from mirror.protocols.views.view import RenderView, ViewShutter

GROUP: Final = "trajectory"
_SECOND_NS: Final = 1_000_000_000
_MAX_HZ: Final = 1000.0
_STAMP: Final = "timestamp_ns"


@dataclass(frozen=True, eq=False)
class VehicleTrajectory:
    """Poses of a vehicle over time.

    Attributes:
        timestamps_ns: (N,) strictly increasing.
        world_SE3_ego: N poses.
    """

    timestamps_ns: Int64
    world_SE3_ego: Poses

    def __len__(self) -> int:
        return len(self.timestamps_ns)

    def shift(self, left_m: float = 0.0, forward_m: float = 0.0, up_m: float = 0.0) -> VehicleTrajectory:
        """Shift every pose in the vehicle's own frame: to the left, forward and up, in metres."""
        shift = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[forward_m, left_m, up_m]]))
        return replace(self, world_SE3_ego=self.world_SE3_ego @ shift)

    def resample(self, hz: float) -> VehicleTrajectory:
        """Interpolate the trajectory at `hz` poses per second, starting at the first pose.

        Raises:
            UsageError: the rate is not positive, or above 1000 Hz.
        """
        period_ns = _period_ns(hz)
        first, last = int(self.timestamps_ns[0]), int(self.timestamps_ns[-1])
        # Half a nanosecond is added because times at 30 Hz are rounded.
        count = int((last - first + 0.5) // period_ns) + 1
        stamps = first + np.round(np.arange(count) * period_ns).astype(np.int64)
        stamps = stamps[stamps <= last]
        return VehicleTrajectory(stamps, interpolate(self.timestamps_ns, self.world_SE3_ego, stamps))


def recorded_trajectory(dataset: Dataset, traversal_id: str) -> VehicleTrajectory:
    """Read the trajectory of a traversal from its first to its last frame, with all recorded poses between them.

    Raises:
        DatasetError: the traversal has no frames.
    """
    frames = dataset.where(traversal=traversal_id).frames()
    if not len(frames):
        raise DatasetError("a traversal without frames", file=dataset.root, place=traversal_id)
    stamps, poses = frames[0].track
    first, last = frames[0].timestamp_ns, frames[len(frames) - 1].timestamp_ns
    within = stamps[(stamps > first) & (stamps < last)]
    times = np.unique(np.concatenate(([first], within, [last])))
    return VehicleTrajectory(times, interpolate(stamps, poses, times))


def read_trajectory(path: Path, hz: float = 10.0) -> VehicleTrajectory:
    """Read a trajectory, in the world frame of the scene, from a file.

    Args:
        path: CSV or Parquet file with the columns ``qw qx qy qz tx_m ty_m tz_m`` and one pose in each row.
        hz: rate of the poses if the file has no column ``timestamp_ns``.

    Raises:
        UsageError: the file does not exist or cannot be read, columns are missing, or times do not increase.
    """
    import pandas as pd

    period_ns = _period_ns(hz)
    if not path.is_file():
        raise UsageError(
            "no such file", file=path, place="--trajectory", remedy="name another file of poses with --trajectory"
        )
    try:
        table = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path, skipinitialspace=True)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"cannot be read: {error}",
            file=path,
            expected="CSV or Parquet",
            remedy="name another file of poses with --trajectory",
        ) from error
    missing = [name for name in COLUMNS if name not in table]
    if missing or not len(table):
        raise UsageError(
            f"no column {', '.join(missing)}" if missing else "no rows", file=path,
            expected=f"columns {' '.join(COLUMNS)}, and {_STAMP} if poses are not evenly spaced",
        )  # fmt: skip
    numbers = {name: pd.to_numeric(table[name], errors="coerce").to_numpy() for name in COLUMNS}
    for name, column in numbers.items():
        if not np.isfinite(column).all():
            row = int(np.argmin(np.isfinite(column)))
            raise UsageError(
                f"{table[name].iloc[row]}", file=path, place=f"row {row}, column {name}", expected="a finite number"
            )
    try:
        poses = Poses.from_columns(numbers)
        stamps = (
            table[_STAMP].to_numpy(np.int64)
            if _STAMP in table
            else np.round(np.arange(len(table)) * period_ns).astype(np.int64)
        )
    except (UsageError, ValueError) as error:
        raise UsageError(
            f"{error}", file=path, remedy="correct the file: a row is one pose, with a unit quaternion"
        ) from error
    if (np.diff(stamps) <= 0).any():
        row = int(np.argmax(np.diff(stamps) <= 0)) + 1
        raise UsageError(
            "times do not increase",
            file=path,
            place=f"row {row}, column {_STAMP}",
            remedy="sort the rows by time, and keep one of each time",
        )
    return VehicleTrajectory(stamps, poses)


def _period_ns(hz: float) -> float:
    if not 0.0 < hz <= _MAX_HZ:
        raise UsageError(f"{hz:g} images per second", place="--hz", expected=f"more than 0, at most {_MAX_HZ:g}")
    return _SECOND_NS / hz


def parse_trajectory(dataset: Dataset, text: str, traversal_id: str, hz: float = 10.0) -> VehicleTrajectory:
    """Make the trajectory that a command-line option names.

    Args:
        dataset: dataset with the recorded traversals.
        text: ``lane-shift:METRES`` (to the left of the base traversal), ``forward:METRES`` (ahead of it), the id of
            a traversal, or a file of poses.
        traversal_id: base traversal that is shifted.
        hz: rate of the poses of a file without times.

    Raises:
        UsageError: the text is none of these.
    """
    kind, _, number = text.partition(":")
    if kind in ("lane-shift", "forward"):
        try:
            metres = float(number)
        except ValueError:
            metres = float("nan")
        if not np.isfinite(metres):
            raise UsageError(
                f"{text!r} has no distance", place="--trajectory", expected=f"{kind}:METRES, such as {kind}:2.0"
            )
        base = recorded_trajectory(dataset, traversal_id)
        return base.shift(left_m=metres) if kind == "lane-shift" else base.shift(forward_m=metres)
    if text in dataset.traversals():
        return recorded_trajectory(dataset, text)
    if Path(text).suffix in (".csv", ".parquet"):
        return read_trajectory(Path(text), hz)
    raise UsageError(
        f"no trajectory {text!r}", place="--trajectory",
        expected="lane-shift:METRES, forward:METRES, a traversal of the dataset, or a file, .csv or .parquet",
    )  # fmt: skip


def plan_views_along(
    dataset: Dataset,
    traversal_id: str,
    trajectory: VehicleTrajectory,
    pixels: Pixels,
    cameras: Sequence[str] | None = None,
) -> tuple[RenderView, ...]:
    """Plan the views of a traversal's cameras along a trajectory.

    Args:
        dataset: dataset with the traversal.
        traversal_id: traversal that gives rig, lenses and appearance.
        trajectory: poses of the vehicle.
        pixels: raster settings of the views.
        cameras: names of the cameras; None: all cameras of the rig.

    Returns:
        Views ordered by time, then by camera.

    Raises:
        UsageError: the rig does not have one of the cameras.
    """
    traversal = dataset.where(traversal=traversal_id)
    images = {camera: image for frame in traversal.frames() for camera, image in frame.images.items()}
    unknown = sorted(set(cameras or ()) - set(images))
    if unknown:
        raise UsageError(
            f"no camera {', '.join(unknown)}", place=f"cameras of {traversal_id}", expected=", ".join(sorted(images))
        )
    row = traversal.table("traversals", ["scene_id", "light", "weather"]).to_pylist()[0]
    rig = []
    for camera in cameras or images:
        image = images[camera]
        lens = final_camera(image.camera_model, pixels)
        rolls = pixels.shutter == "calibrated" and image.shutter.is_rolling
        times = fit_line_times(image.camera_model, image.shutter, lens) if rolls else None
        rig.append((camera, lens, image, times))
    return tuple(
        RenderView(
            path=render_path(GROUP, traversal_id, camera, int(stamp)),
            group=GROUP,
            scene_id=row["scene_id"],
            traversal_id=traversal_id,
            frame_index=index,
            camera=camera,
            timestamp_ns=int(stamp),
            light=row["light"],
            weather=row["weather"],
            **lens.to_row(),
            world_SE3_camera=trajectory.world_SE3_ego[index] @ image.calibration.ego_SE3_camera,
            shutter=None if times is None else _shutter_along(trajectory, int(stamp), image, times),
        )
        for index, stamp in enumerate(trajectory.timestamps_ns)
        for camera, lens, image, times in rig
    )


def _shutter_along(trajectory: VehicleTrajectory, stamp_ns: int, image: Image, times: LineTimes) -> ViewShutter:
    """The rolling shutter of a view at a time of a trajectory; beyond its ends the vehicle keeps its velocity."""
    stamps = stamp_ns + np.round([times.first_ns, times.last_ns]).astype(np.int64)
    egos = interpolate(trajectory.timestamps_ns, trajectory.world_SE3_ego, stamps, extrapolate=True)
    ends = egos @ image.calibration.ego_SE3_camera
    return make_view_shutter(image.shutter, times, ends)
