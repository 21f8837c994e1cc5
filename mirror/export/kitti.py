"""KITTI: the layout of the odometry benchmark, with the labels of the tracking benchmark.

Cameras of KITTI share a rectified frame, which cameras around a vehicle do not have. So each camera of a traversal is a
sequence of its own: ``sequences/0000/image_2``, ``calib.txt``, ``times.txt``, ``poses/0000.txt`` and
``label_02/0000.txt``. ``sequences.json`` states traversal, camera, and the pose of the first image in the world frame.
``Tr`` maps the ego frame, which stands for the lidar's, to the camera frame.

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


def _image_path(item: ExportImage) -> str:
    return f"sequences/{item.sequence:04}/image_2/{item.number:06}.png"


def _write(scene: ExportScene, out: Path, _: ProgressReporter) -> Written:
    sequences: dict[int, list[ExportImage]] = {}
    for item in scene.images:
        sequences.setdefault(item.sequence, []).append(item)
    files, boxes, about = [], 0, []
    for number, items in sequences.items():
        name = f"{number:04}"
        tracks = {track: index for index, track in enumerate(items[0].frame.track_ids)}
        labels = [line for item in items for line in _labels(item, tracks)]
        boxes += len(labels)
        texts = {
            f"sequences/{name}/calib.txt": _calibration(items[0]),
            f"sequences/{name}/times.txt": _times(items),
            f"poses/{name}.txt": _poses(items),
            f"label_02/{name}.txt": "".join(f"{line}\n" for line in labels),
        }
        for path, text in texts.items():
            write_bytes(out / path, text.encode())
            files.append(out / path)
        about.append(_about(name, items, tracks))
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


def _calibration(item: ExportImage) -> str:
    """The matrices of a camera; all four cameras of KITTI are this one."""
    projection = np.column_stack([item.lens.intrinsic_matrix(first_pixel_centre=0.0), np.zeros(3)])
    camera_SE3_ego = item.image.calibration.ego_SE3_camera.inverse().matrix()[0, :3]
    rows = {f"P{number}": projection for number in range(4)} | {"Tr": camera_SE3_ego}
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
    changed = [number for number, items in sequences.items() if len({_calibration(item) for item in items}) > 1]
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
    kept=(
        Kept("pose of each image", "poses/, sequences.json", "1e-9 m, 1e-12 rad"),
        Kept("mounting of the cameras", "Tr", "1e-12"),
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
        "distortion: images are undistorted",
        "exposure, rolling shutter and time offsets",
        "the geodetic reference of the world frame",
        "poses between images",
        "light and weather",
    ),
)
