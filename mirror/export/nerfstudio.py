"""nerfstudio: ``transforms.json`` with a lens and a pose for each image, masks, and points as PLY.

Camera frames are OpenGL's (x right, y up, z back); pixel coordinates are MIRROR's. Its reader takes one camera model
for all images. ``applied_transform`` maps the scene's world frame to that of the file.

Source: https://docs.nerf.studio/quickstart/data_conventions.html
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.errors import UsageError
from mirror.export.layout import ExportLayout, Kept, Written
from mirror.export.lenses import nerfstudio_lens
from mirror.export.scene import ExportImage, ExportScene
from mirror.progress import ProgressReporter
from mirror.schema.files import write_bytes

TRANSFORMS: Final = "transforms.json"
POINTS: Final = "points.ply"
ROLES: Final = {"train": ("train",), "val": ("val", "test", "held_out"), "test": ("test", "held_out", "val")}
"""Roles of a split by the names of nerfstudio; it refuses a file that lists some of its three splits only."""

_OPENGL: Final = np.diag([1.0, -1.0, -1.0, 1.0])


def opengl_pose(item: ExportImage, origin_m: Float64) -> Float64:
    """Return the matrix (4, 4) that maps OpenGL's camera frame to the world frame moved to ``origin_m``."""
    matrix = item.world_SE3_camera.matrix()[0] @ _OPENGL
    matrix[:3, 3] -= origin_m
    return np.asarray(matrix)


def _image_path(item: ExportImage) -> str:
    return f"images/{item.name}"


def _mask_path(item: ExportImage) -> str:
    return f"masks/{Path(item.name).with_suffix('.png').as_posix()}"


def _write(scene: ExportScene, out: Path, _: ProgressReporter) -> Written:
    model = _only_model(scene)
    masked = (out / "masks").is_dir()
    document: dict[str, Any] = {
        "camera_model": model,
        "applied_transform": np.column_stack([np.eye(3), -scene.origin_m]).tolist(),
        "frames": [_frame(item, scene.origin_m, masked) for item in scene.images],
    }
    if scene.split is not None:
        for name, roles in ROLES.items():
            document[f"{name}_filenames"] = [_image_path(item) for item in scene.images if item.role in roles]
    files = [out / TRANSFORMS]
    if scene.points is not None:
        document["ply_file_path"] = POINTS
        write_bytes(out / POINTS, encode_ply(scene.points.position_m - scene.origin_m, scene.points.rgb))
        files.append(out / POINTS)
    write_bytes(out / TRANSFORMS, json.dumps(document, indent=1).encode())
    return Written(tuple(files), points=0 if scene.points is None else len(scene.points))


def _frame(item: ExportImage, origin_m: Float64, masked: bool) -> dict[str, Any]:
    camera = item.lens
    lens = nerfstudio_lens(camera)
    coefficients = {} if lens is None else dict(lens.coefficients)
    entry = {
        "file_path": _image_path(item),
        "w": camera.width_px,
        "h": camera.height_px,
        "fl_x": camera.fx_px,
        "fl_y": camera.fy_px,
        "cx": camera.cx_px,
        "cy": camera.cy_px,
        **coefficients,
        "transform_matrix": opengl_pose(item, origin_m).tolist(),
        "traversal_id": item.frame.traversal_id,
        "camera": item.image.camera,
        "timestamp_ns": item.image.timestamp_ns,
    }
    if masked:
        entry["mask_path"] = _mask_path(item)
    return entry


def _only_model(scene: ExportScene) -> str:
    """The camera model of all images.

    Raises:
        UsageError: fisheyes and perspective lenses are mixed.
    """
    cameras: dict[str, str] = {}
    for item in scene.images:
        lens = nerfstudio_lens(item.lens)
        if lens is not None:
            cameras.setdefault(lens.model, item.image.camera)
    if len(cameras) > 1:
        named = ", ".join(f"{model} ({camera})" for model, camera in cameras.items())
        raise UsageError(
            f"the cameras have several models: {named}", place="camera_model",
            expected="one model, as nerfstudio's reader does", remedy="give --undistort, or choose --camera",
        )  # fmt: skip
    return next(iter(cameras))


def encode_ply(position_m: Float64, rgb: UInt8) -> bytes:
    """Encode points (N, 3) with colours (N, 3) as a binary PLY file with float32 coordinates."""
    rows = np.empty(len(position_m), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    rows["xyz"], rows["rgb"] = position_m, rgb
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    return "\n".join([*header, "end_header", ""]).encode() + rows.tobytes()


LAYOUT: Final = ExportLayout(
    name="nerfstudio",
    title="nerfstudio transforms.json",
    lens_of=nerfstudio_lens,
    image_path=_image_path,
    mask_path=_mask_path,
    needs_all_masks=True,
    write=_write,
    kept=(
        Kept("pose of each image", "transform_matrix", "1e-9 m, 1e-12 rad; nerfstudio reads float32: 3e-5 m at 500 m"),
        Kept("focal lengths, principal point, distortion", "fl_x ... p2", "exact"),
        Kept("position of points", "points.ply", "float32: 3e-5 m at 500 m"),
        Kept("colour of points", "points.ply", "exact"),
        Kept("traversal, camera, time of each image", "frames[]", "exact"),
        Kept("masks of what is not the static street", "masks/", "exact"),
        Kept("roles of a split", "train_filenames, val_filenames, test_filenames", "exact"),
    ),
    lost=(
        "boxes and their tracks",
        "depth maps",
        "lidar sweeps",
        "exposure, rolling shutter and time offsets",
        "the geodetic reference of the world frame",
        "kind and standard deviation of points, and which traversal observed them",
        "calibration stages, validity and covariance",
        "poses between images",
        "light and weather",
    ),
    holds_points=True,
)
