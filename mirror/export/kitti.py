"""KITTI: the layout of the odometry benchmark, with the labels of the tracking benchmark.

Cameras of KITTI share a rectified frame, which cameras around a vehicle do not have. So each camera of a traversal is a
sequence of its own: ``sequences/0000/image_2``, ``calib.txt``, ``times.txt``, ``poses/0000.txt`` and
``label_02/0000.txt``. ``sequences.json`` states traversal, camera, and the pose of the first image in the world frame.
``Tr`` maps the lidar's frame to the camera frame; without sweeps the ego frame stands for it. A sequence has the sweep
nearest to each image, within half a period of the images, if its file has KITTI's format.

Sources: https://www.cvlibs.net/datasets/kitti/eval_odometry.php, readme.txt of the tracking devkit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.traversal import FrameBoxes
from mirror.export.layout import ExportLayout, Kept, Written
from mirror.export.lenses import pinhole_lens
from mirror.export.lidars import Sweep, SweepFiles, list_sweeps, present_sweeps
from mirror.export.scene import ExportImage, ExportScene
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.poses import Poses
from mirror.progress import ProgressReporter
from mirror.schema.files import write_bytes

CATEGORIES: Final = {
    "car": "Car",
    "van": "Van",
    "truck": "Truck",
    "bus": "Truck",
    "pedestrian": "Pedestrian",
    "cyclist": "Cyclist",
    "bicycle": "Cyclist",
    "tram": "Tram",
}
"""Words of KITTI by category; all others are Misc."""

_UNKNOWN_OCCLUSION: Final = 3
_SWEEPS: Final = "kitti_velodyne_bin"


def _image_path(item: ExportImage) -> str:
    return f"sequences/{item.sequence:04}/image_2/{item.number:06}.png"


def _write(scene: ExportScene, out: Path, _: ProgressReporter) -> Written:
    sequences, lidars = _sequences(scene), present_sweeps(list_sweeps(scene))[0]
    files, boxes, about = [], 0, []
    for number, items in sequences.items():
        name = f"{number:04}"
        tracks = {track: index for index, track in enumerate(items[0].frame.track_ids)}
        labels = [line for item in items for line in _labels(item, tracks)]
        boxes += len(labels)
        sweeps = _sweeps_of_images(items, lidars)
        lidar = next(iter(sweeps.values())).ego_SE3_sensor if sweeps else Poses.identity()
        texts = {
            f"sequences/{name}/calib.txt": _calibration(items[0], lidar),
            f"sequences/{name}/times.txt": _times(items),
            f"poses/{name}.txt": _poses(items),
            f"label_02/{name}.txt": "".join(f"{line}\n" for line in labels),
        }
        for path, text in texts.items():
            write_bytes(out / path, text.encode())
            files.append(out / path)
        about.append(_about(name, items, tracks) | _about_sweeps(sweeps))
    write_bytes(out / "sequences.json", json.dumps(about, indent=1).encode())
    return Written((*files, out / "sequences.json"), boxes=boxes, notes=_changing(sequences))


def _about(name: str, items: Sequence[ExportImage], tracks: Mapping[str, int]) -> dict[str, Any]:
    first = items[0]
    return {
        "sequence": name,
        "traversal_id": first.frame.traversal_id,
        "camera": first.image.camera,
        "role": first.role,
        "first_timestamp_ns": first.image.timestamp_ns,
        "world_SE3_first_camera": first.world_SE3_camera.matrix()[0].tolist(),
        "tracks": {str(number): track for track, number in tracks.items()},
    }


def _sequences(scene: ExportScene) -> dict[int, list[ExportImage]]:
    """Images by sequence, in order of time."""
    found: dict[int, list[ExportImage]] = {}
    for item in scene.images:
        found.setdefault(item.sequence, []).append(item)
    return found


def _sweep_files(scene: ExportScene) -> SweepFiles:
    lidars, notes = present_sweeps(list_sweeps(scene))
    places: dict[str, Sweep] = {}
    for number, items in _sequences(scene).items():
        for image, sweep in _sweeps_of_images(items, lidars).items():
            places[f"sequences/{number:04}/velodyne/{image:06}.bin"] = sweep
    placed = {one.uri for one in places.values()}
    lost = sum(one.uri not in placed for every in lidars.values() for one in every)
    if lost:
        notes = (*notes, f"{lost} lidar sweeps have no place: no image is near, or they are not in KITTI's format")
    return SweepFiles(places, notes)


def _sweeps_of_images(items: Sequence[ExportImage], lidars: Mapping[str, Sequence[Sweep]]) -> dict[int, Sweep]:
    """The sweep of each image of a sequence by the image's number: of the first lidar, each sweep once."""
    sweeps = [one for one in lidars.get(items[0].frame.traversal_id, ()) if one.format == _SWEEPS]
    sweeps = [one for one in sweeps if one.sensor == sweeps[0].sensor]
    if not sweeps:
        return {}
    stamps = np.array([item.image.timestamp_ns for item in items], np.int64)
    apart = np.abs(np.array([one.timestamp_ns for one in sweeps], np.int64)[:, None] - stamps[None])
    half = 0.5 * float(np.median(np.diff(stamps))) if len(stamps) > 1 else np.inf
    image = apart.argmin(axis=1)
    mutual = (apart.argmin(axis=0)[image] == np.arange(len(sweeps))) & (apart.min(axis=1) <= half)
    return {items[image[row]].number: sweeps[row] for row in np.flatnonzero(mutual).tolist()}


def _about_sweeps(sweeps: Mapping[int, Sweep]) -> dict[str, Any]:
    if not sweeps:
        return {}
    first = next(iter(sweeps.values()))
    stamps = {str(number): one.timestamp_ns for number, one in sorted(sweeps.items())}
    return {
        "lidar": {
            "sensor": first.sensor,
            "ego_SE3_lidar": first.ego_SE3_sensor.matrix()[0].tolist(),
            "timestamp_ns": stamps,
        }
    }


def _calibration(item: ExportImage, ego_SE3_lidar: Poses) -> str:
    """The matrices of a camera; all four cameras of KITTI are this one."""
    projection = np.column_stack([item.lens.intrinsic_matrix(first_pixel_centre=0.0), np.zeros(3)])
    camera_SE3_lidar = (item.image.calibration.ego_SE3_camera.inverse() @ ego_SE3_lidar).matrix()[0, :3]
    rows = {f"P{number}": projection for number in range(4)} | {"Tr": camera_SE3_lidar}
    return "".join(f"{name}: {_numbers(matrix)}\n" for name, matrix in rows.items())


def _times(items: Sequence[ExportImage]) -> str:
    start = items[0].image.timestamp_ns
    return "".join(f"{(item.image.timestamp_ns - start) / 1e9:.9f}\n" for item in items)


def _poses(items: Sequence[ExportImage]) -> str:
    first = items[0].world_SE3_camera.inverse()
    return "".join(f"{_numbers((first @ item.world_SE3_camera).matrix()[0, :3])}\n" for item in items)


def _labels(item: ExportImage, tracks: Mapping[str, int]) -> list[str]:
    """Lines of the tracking benchmark for the boxes that an image shows."""
    boxes = item.frame.boxes("world")
    if not len(boxes):
        return []
    camera_SE3_box = item.world_SE3_camera.inverse() @ boxes.pose
    shown = project_boxes(item.lens, camera_SE3_box, boxes.size_m)
    return [
        _label(item, boxes, camera_SE3_box, shown.bounds_px[row], row, tracks)
        for row in np.flatnonzero(shown.visible).tolist()
    ]


def _label(
    item: ExportImage, boxes: FrameBoxes, camera_SE3_box: Poses, bounds: Float64, row: int, tracks: Mapping[str, int]
) -> str:
    length, width, height = boxes.size_m[row].tolist()
    matrix = camera_SE3_box.matrix()[row]
    # The bottom's centre; z of a box points up, y of the camera down.
    x, y, z = (matrix[:3, 3] - 0.5 * height * matrix[:3, 2]).tolist()
    rotation_y = float(np.arctan2(-matrix[2, 0], matrix[0, 0]))
    alpha = _wrap(rotation_y - float(np.arctan2(x, z)))
    score = boxes.score[row]
    words = [
        str(item.number), str(tracks[boxes.track_id[row]]), CATEGORIES.get(boxes.category[row], "Misc"),
        "0" if _is_whole(item, bounds) else "1", str(_UNKNOWN_OCCLUSION),
        *(f"{value:.6f}" for value in (alpha, *(bounds - 0.5).tolist(), height, width, length, x, y, z, rotation_y)),
    ]  # fmt: skip
    return " ".join(words if np.isnan(score) else [*words, f"{score:.6f}"])


def _is_whole(item: ExportImage, bounds: Float64) -> bool:
    """Return whether a box lies inside the image; KITTI's tracking labels call other boxes truncated."""
    left, top, right, bottom = bounds.tolist()
    return bool(left > 0.0 and top > 0.0 and right < item.lens.width_px and bottom < item.lens.height_px)


def _changing(sequences: Mapping[int, Sequence[ExportImage]]) -> tuple[str, ...]:
    """A note on sequences whose calibration changes: KITTI has one for a sequence."""
    ego = Poses.identity()
    changed = [number for number, items in sequences.items() if len({_calibration(item, ego) for item in items}) > 1]
    if not changed:
        return ()
    return (f"the calibration changes in {len(changed)} sequences; the first one is written",)


def _numbers(matrix: Float64) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(matrix))


def _wrap(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


LAYOUT: Final = ExportLayout(
    name="kitti",
    title="KITTI odometry with tracking labels",
    lens_of=pinhole_lens,
    image_path=_image_path,
    mask_path=None,
    needs_all_masks=False,
    write=_write,
    sweeps=_sweep_files,
    kept=(
        Kept("pose of each image", "poses/, sequences.json", "1e-9 m, 1e-12 rad"),
        Kept("mounting of the cameras", "Tr, sequences.json", "1e-12"),
        Kept("lidar sweeps in KITTI's format, one an image", "velodyne, sequences.json", "exact, mounting 1e-12"),
        Kept("focal lengths, principal point", "P0 ... P3", "1e-12 px"),
        Kept("time of images", "times.txt, sequences.json", "1 ns"),
        Kept("centre and size of boxes", "label_02", "1e-6 m for upright boxes in an upright camera"),
        Kept("yaw of boxes", "label_02", "1e-6 rad for upright boxes in an upright camera"),
        Kept("tracks", "label_02, sequences.json", "exact"),
        Kept("traversal, camera, role", "sequences.json", "exact"),
    ),
    lost=(
        "pitch and roll of boxes in the camera frame",
        "categories other than KITTI's",
        "occlusion of boxes",
        "which cameras belong to a frame",
        "the JPEG bytes: images are PNG files",
        "masks, depth maps, points",
        "lidar sweeps of other formats, of a second lidar, or without an image near",
        "distortion: images are undistorted",
        "exposure, rolling shutter and time offsets",
        "the geodetic reference of the world frame",
        "poses between images",
        "light and weather",
    ),
)
