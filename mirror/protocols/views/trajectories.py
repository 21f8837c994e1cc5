"""Where a vehicle drives that nobody drove: beside or ahead of a recorded traversal, or along given poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import COLUMNS, Poses
from mirror.protocols.document import Pixels
from mirror.protocols.views.final_camera import final_camera
from mirror.protocols.views.plan import render_path
from mirror.protocols.views.view import RenderView, to_pose_numbers

GROUP: Final = "trajectory"
_SECOND_NS: Final = 1_000_000_000
_MOST_HZ: Final = 1000.0
_STAMP: Final = "timestamp_ns"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of a vehicle over time.

    Attributes:
        timestamps_ns: (N,) strictly increasing.
        world_SE3_ego: N poses.
    """

    timestamps_ns: Int64
    world_SE3_ego: Poses

    def __len__(self) -> int:
        return len(self.timestamps_ns)

    def shifted(self, left_m: float = 0.0, forward_m: float = 0.0, up_m: float = 0.0) -> Trajectory:
        """The same way beside, ahead of or above itself, seen from the vehicle."""
        aside = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[forward_m, left_m, up_m]]))
        return replace(self, world_SE3_ego=self.world_SE3_ego @ aside)

    def resample(self, hz: float) -> Trajectory:
        """So many poses a second, from the first on.

        Raises:
            UsageError: no such rate.
        """
        apart = _apart_ns(hz)
        first, last = int(self.timestamps_ns[0]), int(self.timestamps_ns[-1])
        # Half a nanosecond more: times of 30 Hz are rounded.
        count = int((last - first + 0.5) // apart) + 1
        stamps = first + np.round(np.arange(count) * apart).astype(np.int64)
        stamps = stamps[stamps <= last]
        return Trajectory(stamps, interpolate(self.timestamps_ns, self.world_SE3_ego, stamps))


def recorded_trajectory(dataset: Dataset, traversal_id: str) -> Trajectory:
    """What a traversal drove from its first frame to its last, as dense as its poses are.

    Raises:
        DatasetError: it has no frames.
    """
    frames = dataset.where(traversal=traversal_id).frames()
    if not len(frames):
        raise DatasetError("a traversal without frames", file=dataset.root, place=traversal_id)
    stamps, poses = frames[0].track
    first, last = frames[0].timestamp_ns, frames[len(frames) - 1].timestamp_ns
    within = stamps[(stamps > first) & (stamps < last)]
    every = np.unique(np.concatenate(([first], within, [last])))
    return Trajectory(every, interpolate(stamps, poses, every))


def read_trajectory(path: Path, hz: float = 10.0) -> Trajectory:
    """Poses of a vehicle in the world of the scene, from a file.

    Args:
        path: CSV or Parquet with the columns ``qw qx qy qz tx_m ty_m tz_m``, a row a pose.
        hz: how fast they follow each other where there is no column ``timestamp_ns``.

    Raises:
        UsageError: there is no such file, it cannot be read, columns are missing, or times do not increase.
    """
    import pandas as pd

    apart = _apart_ns(hz)
    if not path.is_file():
        raise UsageError("no such file", file=path)
    try:
        table = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path, skipinitialspace=True)
    except (OSError, ValueError) as error:
        raise UsageError(f"not to be read: {error}", file=path, expected="CSV or Parquet") from error
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
            else np.round(np.arange(len(table)) * apart).astype(np.int64)
        )
    except (UsageError, ValueError) as error:
        raise UsageError(f"{error}", file=path) from error
    if (np.diff(stamps) <= 0).any():
        row = int(np.argmax(np.diff(stamps) <= 0)) + 1
        raise UsageError("times do not increase", file=path, place=f"row {row}, column {_STAMP}")
    return Trajectory(stamps, poses)


def _apart_ns(hz: float) -> float:
    if not 0.0 < hz <= _MOST_HZ:
        raise UsageError(f"{hz:g} pictures a second", place="--hz", expected=f"more than none, at most {_MOST_HZ:g}")
    return _SECOND_NS / hz


def parse_trajectory(dataset: Dataset, text: str, traversal_id: str, hz: float = 10.0) -> Trajectory:
    """The trajectory that a command line names.

    Args:
        dataset: with the recorded ones.
        text: ``lane-shift:METRES`` to the left of a traversal, ``forward:METRES`` ahead of it, the id of another
            traversal, or a file of poses.
        traversal_id: the one beside or ahead of which.
        hz: how fast the poses of a file follow each other that says no times.

    Raises:
        UsageError: it is none of these.
    """
    kind, _, number = text.partition(":")
    if kind in ("lane-shift", "forward"):
        try:
            metres = float(number)
        except ValueError:
            metres = float("nan")
        if not np.isfinite(metres):
            raise UsageError(
                f"{text!r} says no distance", place="--trajectory", expected=f"{kind}:METRES, such as {kind}:2.0"
            )
        base = recorded_trajectory(dataset, traversal_id)
        return base.shifted(left_m=metres) if kind == "lane-shift" else base.shifted(forward_m=metres)
    if text in dataset.traversals():
        return recorded_trajectory(dataset, text)
    if Path(text).suffix in (".csv", ".parquet"):
        return read_trajectory(Path(text), hz)
    raise UsageError(
        f"no trajectory {text!r}", place="--trajectory",
        expected="lane-shift:METRES, forward:METRES, a traversal of the dataset, or a file, .csv or .parquet",
    )  # fmt: skip


def plan_views_along(
    dataset: Dataset, traversal_id: str, trajectory: Trajectory, pixels: Pixels, cameras: Sequence[str] | None = None
) -> tuple[RenderView, ...]:
    """What the cameras of a traversal's rig see along a trajectory.

    Args:
        dataset: with the traversal.
        traversal_id: whose rig, lenses and appearance are taken.
        trajectory: where.
        pixels: the raster and lens of pictures.
        cameras: of the rig; None: all.

    Returns:
        Views by time, then by camera.

    Raises:
        UsageError: the rig has no such camera.
    """
    own = dataset.where(traversal=traversal_id)
    images = {camera: image for frame in own.frames() for camera, image in frame.images.items()}
    unknown = sorted(set(cameras or ()) - set(images))
    if unknown:
        raise UsageError(
            f"no camera {', '.join(unknown)}", place=f"cameras of {traversal_id}", expected=", ".join(sorted(images))
        )
    row = own.table("traversals", ["scene_id", "light", "weather"]).to_pylist()[0]
    rig = [
        (camera, final_camera(images[camera].camera_model, pixels), images[camera].calibration.ego_SE3_camera)
        for camera in (cameras or images)
    ]
    return tuple(
        RenderView(
            path=render_path(GROUP, traversal_id, camera, int(stamp)),
            group=GROUP,
            scene_id=row["scene_id"],
            traversal_id=traversal_id,
            frame_index=place,
            camera=camera,
            timestamp_ns=int(stamp),
            light=row["light"],
            weather=row["weather"],
            model=lens.model,
            width_px=lens.width_px,
            height_px=lens.height_px,
            fx_px=lens.fx_px,
            fy_px=lens.fy_px,
            cx_px=lens.cx_px,
            cy_px=lens.cy_px,
            distortion=lens.distortion,
            world_SE3_camera=to_pose_numbers(trajectory.world_SE3_ego[place] @ ego_SE3_camera),
        )
        for place, stamp in enumerate(trajectory.timestamps_ns)
        for camera, lens, ego_SE3_camera in rig
    )
