"""LeRobot v3.0: one episode for each traversal, one row for each frame, images as they are in Parquet files.

A row needs every feature, so frames without an image of some camera are left out. A traversal with gaps in time is
several episodes, see `episode_times`. LeRobot states times as seconds in float32 and a fixed rate; the column
``timestamp_ns`` has the exact stamps. The state is the pose of the vehicle in the world frame; the action is its
motion to the next frame, in its own frame. ``meta/cameras.json`` states lenses and mountings. Statistics of images are
those of at most `SAMPLED` images of each camera.

Source: https://github.com/huggingface/lerobot (``lerobot/datasets/utils.py`` of version 0.4).
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mirror.arrays import Float64
from mirror.counting import count_of
from mirror.dataset.frames import Frame
from mirror.errors import UsageError
from mirror.export.episode_times import drift_s, rates, split_at_gaps
from mirror.export.files import image_bytes
from mirror.export.layout import ExportLayout, Kept, Written
from mirror.export.samples import describe_camera, own_lens
from mirror.export.scene import ExportImage, ExportScene
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion
from mirror.progress import ProgressReporter
from mirror.schema.files import TEMPORARY, unwritable_error, write_bytes

VERSION: Final = "v3.0"
FILE_BYTES: Final = 100 * 1024 * 1024
"""A data file ends with the episode that reaches this size; LeRobot's own default."""

SAMPLED: Final = 32
_FILES_IN_CHUNK: Final = 1000
_POSE: Final = ["qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"]
_MOTION: Final = ["forward_m", "left_m", "turn_left_rad"]
_INDEX: Final = ("frame_index", "episode_index", "index", "task_index")
_PATH: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


@dataclass(frozen=True)
class Episode:
    """Consecutive complete frames of one traversal without a gap, with the images by camera."""

    traversal_id: str
    task: str
    frames: tuple[tuple[Frame, dict[str, ExportImage]], ...]

    @property
    def stamps(self) -> list[int]:
        """Times of the frames, Unix nanoseconds."""
        return [frame.timestamp_ns for frame, _ in self.frames]


def _feature(camera: str) -> str:
    return f"observation.images.{camera}"


def _image_path(item: ExportImage) -> str:
    return f"{_feature(item.image.camera)}/{item.frame.traversal_id}/{item.frame.frame_index:06}{item.suffix}"


def _cameras(scene: ExportScene) -> list[str]:
    return sorted({item.image.camera for item in scene.images})


def _require(scene: ExportScene) -> None:
    """Refuse scenes whose images of a camera differ in size, or without a complete frame."""
    _rasters(scene, _cameras(scene))
    complete_episodes(scene, _cameras(scene))


def _write(scene: ExportScene, out: Path, progress: ProgressReporter) -> Written:
    cameras = _cameras(scene)
    rasters = _rasters(scene, cameras)
    episodes, left_out = complete_episodes(scene, cameras)
    tasks = list(dict.fromkeys(episode.task for episode in episodes))
    features = _features(cameras, rasters)
    progress.start("frames", sum(len(episode.frames) for episode in episodes))
    files: list[Path] = []
    rows: list[dict[str, Any]] = []
    first, size, number = 0, 0, 0
    waiting: list[pa.Table] = []
    numbers: list[pa.Table] = []

    def flush() -> None:
        nonlocal size, number
        path = out / "data" / _PATH.format(chunk_index=number // _FILES_IN_CHUNK, file_index=number % _FILES_IN_CHUNK)
        _write_table(path, waiting)
        files.append(path)
        waiting.clear()
        size, number = 0, number + 1

    for index, episode in enumerate(episodes):
        table = _rows(episode, cameras, index, first, tasks.index(episode.task), progress)
        count = table.num_rows
        place = {"chunk_index": number // _FILES_IN_CHUNK, "file_index": number % _FILES_IN_CHUNK}
        rows.append(
            {
                "episode_index": index,
                "tasks": [episode.task],
                "length": count,
                "dataset_from_index": first,
                "dataset_to_index": first + count,
                **{f"data/{name}": value for name, value in place.items()},
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                "traversal_id": episode.traversal_id,
            }
        )
        first += count
        waiting.append(table)
        numbers.append(table.drop_columns([_feature(camera) for camera in cameras]))
        size += table.nbytes
        if size >= FILE_BYTES:
            flush()
    if waiting:
        flush()
    _write_table(out / "meta" / "episodes" / "chunk-000" / "file-000.parquet", [pa.Table.from_pylist(rows)])
    files.append(out / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    files += _write_meta(scene, out, episodes, tasks, features, pa.concat_tables(numbers), cameras)
    notes = [f"{left_out} frames lack an image of a camera and are left out"] if left_out else []
    rate_hz, fps = rates([episode.stamps for episode in episodes])
    if abs(rate_hz - fps) > 0.05 * fps:
        notes.append(f"frames come at {rate_hz:.3g} Hz, which LeRobot states as a whole number: {fps}")
    splits = len(episodes) - len({episode.traversal_id for episode in episodes})
    if splits:
        notes.append(f"traversals are split into {len(episodes)} episodes, at {count_of(splits, 'gap')} in time")
    difference_s = max(drift_s(episode.stamps, fps) for episode in episodes)
    if difference_s > 0.5 / fps:
        notes.append(f"times differ from frame_index / fps by up to {difference_s:.2g} s; timestamp_ns is exact")
    return Written(tuple(files), notes=tuple(notes))


def _rasters(scene: ExportScene, cameras: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Height and width of each camera's images.

    Raises:
        UsageError: a camera has images of several sizes.
    """
    found: dict[str, set[tuple[int, int]]] = {camera: set() for camera in cameras}
    for item in scene.images:
        found[item.image.camera].add((item.lens.height_px, item.lens.width_px))
    for camera, sizes in found.items():
        if len(sizes) > 1:
            raise UsageError(
                f"images of {len(sizes)} sizes: {sorted(sizes)}",
                place=f"camera {camera}",
                expected="one size for each camera: a feature of LeRobot has one shape",
                remedy="choose traversals of one kind of vehicle: --traversal ID ...",
            )
    return {camera: next(iter(sizes)) for camera, sizes in found.items()}


def complete_episodes(scene: ExportScene, cameras: Sequence[str]) -> tuple[list[Episode], int]:
    """Return the runs of complete frames of each traversal, and the number of incomplete frames.

    Args:
        scene: what is exported.
        cameras: the cameras of a complete frame.

    Raises:
        UsageError: no frame has images of all cameras.
    """
    episodes, left_out = [], 0
    for traversal_id, frames in scene.by_traversal():
        traversal = scene.traversals[traversal_id]
        complete = [(frame, {item.image.camera: item for item in images}) for frame, images in frames]
        complete = [entry for entry in complete if len(entry[1]) == len(cameras)]
        left_out += len(frames) - len(complete)
        if complete:
            task = f"drive, {traversal['light']}, {traversal['weather']}"
            stamps = [frame.timestamp_ns for frame, _ in complete]
            episodes += [Episode(traversal_id, task, tuple(complete[part])) for part in split_at_gaps(stamps)]
    if not episodes:
        raise UsageError(
            f"no frame has an image of each of the cameras {', '.join(cameras)}",
            place="--camera",
            expected="frames with all cameras: a row of LeRobot has every feature",
            remedy="choose cameras that all vehicles have: --camera NAME ...",
        )
    return episodes, left_out


def _features(cameras: Sequence[str], rasters: Mapping[str, tuple[int, int]]) -> dict[str, dict[str, Any]]:
    """The features of ``meta/info.json``, in the order of the columns."""

    def numbers(kind: str, names: list[str] | None, count: int = 1) -> dict[str, Any]:
        return {"dtype": kind, "shape": [count], "names": names}

    images = {
        _feature(camera): {"dtype": "image", "shape": [*rasters[camera], 3], "names": ["height", "width", "channels"]}
        for camera in cameras
    }
    poses = {f"observation.camera_poses.{camera}": numbers("float64", _POSE, 7) for camera in cameras}
    stamps = {f"timestamp_ns.{camera}": numbers("int64", None) for camera in cameras}
    return {
        **images,
        "observation.state": numbers("float64", _POSE, 7),
        **poses,
        "action": numbers("float64", _MOTION, 3),
        "timestamp_ns": numbers("int64", None),
        **stamps,
        "timestamp": numbers("float32", None),
        **{name: numbers("int64", None) for name in _INDEX},
    }


def _rows(
    episode: Episode, cameras: Sequence[str], number: int, first: int, task: int, progress: ProgressReporter
) -> pa.Table:
    frames = [frame for frame, _ in episode.frames]
    count, stamps = len(frames), np.array(episode.stamps, np.int64)
    encoded_images: dict[str, list[dict[str, Any]]] = {camera: [] for camera in cameras}
    for frame, by_camera in episode.frames:
        for camera in cameras:
            item = by_camera[camera]
            name = f"{frame.traversal_id}-{frame.frame_index:06}-{camera}{item.suffix}"
            encoded_images[camera].append({"bytes": image_bytes(item, item.suffix), "path": name})
        progress.advance(1)
    ego = _join([frame.world_SE3_ego for frame in frames])
    of_cameras = {
        camera: _join([by_camera[camera].world_SE3_camera for _, by_camera in episode.frames]) for camera in cameras
    }
    encoded = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    columns = {
        **{_feature(camera): pa.array(encoded_images[camera], encoded) for camera in cameras},
        "observation.state": _vectors(_seven(ego)),
        **{f"observation.camera_poses.{camera}": _vectors(_seven(of_cameras[camera])) for camera in cameras},
        "action": _vectors(motions(ego)),
        "timestamp_ns": pa.array(stamps),
        **{
            f"timestamp_ns.{camera}": pa.array(
                [by_camera[camera].image.timestamp_ns for _, by_camera in episode.frames]
            )
            for camera in cameras
        },
        "timestamp": pa.array(((stamps - stamps[0]) * 1e-9).astype(np.float32)),
        "frame_index": pa.array(np.arange(count)),
        "episode_index": pa.array(np.full(count, number)),
        "index": pa.array(first + np.arange(count)),
        "task_index": pa.array(np.full(count, task)),
    }
    return pa.table(columns)


def motions(world_SE3_ego: Poses) -> Float64:
    """Return the motion (N, 3) from each pose to the next: metres forward and to the left, and radians to the left.

    The last one is repeated.
    """
    if len(world_SE3_ego) < 2:
        return np.zeros((len(world_SE3_ego), 3))
    step = world_SE3_ego[:-1].inverse() @ world_SE3_ego[1:]
    ahead = matrix_from_quaternion(step.rotation)[:, :, 0]
    motion = np.column_stack([step.translation[:, :2], np.arctan2(ahead[:, 1], ahead[:, 0])])
    return np.concatenate([motion, motion[-1:]])


def _join(poses: Sequence[Poses]) -> Poses:
    return Poses(
        np.concatenate([pose.rotation for pose in poses]), np.concatenate([pose.translation for pose in poses])
    )


def _seven(poses: Poses) -> Float64:
    return np.concatenate([poses.rotation, poses.translation], axis=1)


def _vectors(values: Float64) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _write_table(path: Path, tables: Sequence[pa.Table]) -> None:
    """Write a Parquet file with one row group for each episode, under a temporary name."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with pq.ParquetWriter(temporary, tables[0].schema) as writer:
            for table in tables:
                writer.write_table(table, row_group_size=max(table.num_rows, 1))
        temporary.replace(path)
    except OSError as error:
        raise unwritable_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def _write_meta(
    scene: ExportScene, out: Path, episodes: Sequence[Episode], tasks: Sequence[str],
    features: Mapping[str, Mapping[str, Any]], numbers: pa.Table, cameras: Sequence[str],
) -> list[Path]:  # fmt: skip
    import pandas as pd

    roles: dict[str, list[int]] = {}
    for number, episode in enumerate(episodes):
        roles.setdefault(next(iter(episode.frames[0][1].values())).role or "train", []).append(number)
    info = {
        "codebase_version": VERSION,
        "robot_type": "vehicle",
        "total_episodes": len(episodes),
        "total_frames": numbers.num_rows,
        "total_tasks": len(tasks),
        "chunks_size": _FILES_IN_CHUNK,
        "data_files_size_in_mb": FILE_BYTES // 2**20,
        "video_files_size_in_mb": 200,
        "fps": rates([episode.stamps for episode in episodes])[1],
        # LeRobot states ranges; episodes of one role need not follow each other.
        "splits": {role: ",".join(map(str, members)) for role, members in roles.items()} if scene.split else
        {"train": f"0:{len(episodes)}"},
        "data_path": f"data/{_PATH}",
        "video_path": None,
        "features": features,
    }  # fmt: skip
    statistics = {
        **{_feature(camera): _image_statistics(episodes, camera) for camera in cameras},
        **{name: _statistics(numbers.column(name)) for name in numbers.column_names},
    }
    about = {
        episode.traversal_id: {camera: _without_pose(item) for camera, item in episode.frames[0][1].items()}
        for episode in episodes
    }
    documents = {"info.json": info, "stats.json": statistics, "cameras.json": about}
    for name, document in documents.items():
        write_bytes(out / "meta" / name, (json.dumps(document, indent=1) + "\n").encode())
    table = pd.DataFrame({"task_index": range(len(tasks))}, index=list(tasks))
    write_bytes(out / "meta" / "tasks.parquet", table.to_parquet())
    return [out / "meta" / name for name in (*documents, "tasks.parquet")]


def _without_pose(item: ExportImage) -> dict[str, Any]:
    changing = ("timestamp_ns", "exposure_start_ns", "exposure_end_ns", "world_SE3_camera", "privacy")
    return {name: value for name, value in describe_camera(item).items() if name not in changing}


def _statistics(column: pa.ChunkedArray) -> dict[str, Any]:
    values = np.array(column.to_pylist(), np.float64).reshape(len(column), -1)
    parts = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    return {**{name: part.tolist() for name, part in parts.items()}, "count": [len(values)]}


def _image_statistics(episodes: Sequence[Episode], camera: str) -> dict[str, Any]:
    """Statistics of the colours (red, green, blue) in 0 to 1, as LeRobot shapes them: (3, 1, 1)."""
    items = [by_camera[camera] for episode in episodes for _, by_camera in episode.frames]
    chosen = [items[row] for row in np.unique(np.linspace(0, len(items) - 1, SAMPLED).round().astype(int))]
    pixels = []
    for item in chosen:
        data = np.frombuffer(image_bytes(item, item.suffix), np.uint8)
        decoded = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))
        pixels.append(decoded[::4, ::4, ::-1].reshape(-1, 3) / 255.0)
    values = np.concatenate(pixels)
    parts = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    return {**{name: part.reshape(3, 1, 1).tolist() for name, part in parts.items()}, "count": [len(chosen)]}


LAYOUT: Final = ExportLayout(
    name="lerobot",
    title="LeRobot dataset v3.0",
    lens_of=own_lens,
    image_path=_image_path,
    mask_path=None,
    needs_all_masks=False,
    write=_write,
    require=_require,
    holds_images=True,
    kept=(
        Kept("bytes of each image", "observation.images.<camera>", "exact; frames of videos become PNG"),
        Kept("pose of the vehicle", "observation.state", "exact; LeRobot hands out float32: 3e-5 m at 500 m"),
        Kept("pose of each image", "observation.camera_poses.<camera>", "exact; LeRobot hands out float32"),
        Kept("lenses of every model, mountings, rolling shutter", "meta/cameras.json", "exact, of the first frame"),
        Kept("time of frames and images", "timestamp_ns, timestamp_ns.<camera>", "exact; timestamp: float32 seconds"),
        Kept("traversals", "traversal_id in meta/episodes", "exact"),
        Kept("light and weather", "tasks", "exact"),
        Kept("roles of a split", "splits in meta/info.json", "exact"),
    ),
    lost=(
        "frames without an image of some camera",
        "boxes, masks, depth maps, points",
        "lidar sweeps",
        "lengths of exposures",
        "the geodetic reference of the world frame",
        "calibrations that change within a traversal, their stages and covariance",
        "poses between images",
        "statistics of each episode",
    ),
)
