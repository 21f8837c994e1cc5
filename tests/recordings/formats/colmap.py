"""Writes drives as a COLMAP model with its images, through pycolmap."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion
from tests.recordings.formats.street import StreetDrive


def write_colmap(
    root: Path,
    drives: Sequence[StreetDrive],
    *,
    text: bool = False,
    rigs: bool = True,
    names: str = "stamps",
    folder: str = "sparse/0",
) -> Path:
    """Write a model, and return the recording's folder. The drives' world is the model's.

    Args:
        root: the recording's folder.
        drives: the drives; one drive has no folder of its own.
        text: text files instead of binary ones.
        rigs: the cameras of a drive are one rig, with the images of one index in one frame, taken at the reference
            camera's stamp; else every image is a frame of its own at its own stamp.
        names: ``stamps`` (nanoseconds) or ``numbers``.
        folder: of the model.
    """
    import pycolmap

    model = pycolmap.Reconstruction()
    ids = {"camera": 0, "image": 0, "frame": 0, "rig": 0}
    for drive in drives:
        cameras = {name: _add_camera(model, drive, name, ids) for name in drive.cameras}
        if rigs:
            _add_rig(pycolmap, model, drive, cameras, ids)
        else:
            for name in drive.cameras:
                _add_rig(pycolmap, model, drive.with_cameras((name,)), {name: cameras[name]}, ids)
        reference = next(iter(drive.cameras))
        prefix = f"{drive.name}/" if len(drives) > 1 else ""
        for image in model.images.values():
            if image.camera_id not in cameras.values():
                continue
            camera = next(name for name, key in cameras.items() if key == image.camera_id)
            index = int(image.name)
            stamp = drive.image_ns[reference if rigs else camera][index]
            image.name = f"{prefix}{camera}/{stamp if names == 'stamps' else f'img{index}'}.jpg"
            file = root / "images" / image.name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(drive.image(camera, index))
    (root / folder).mkdir(parents=True, exist_ok=True)
    (model.write_text if text else model.write_binary)(str(root / folder))
    return root


def rigid3d(pycolmap: Any, pose: Poses) -> Any:
    """One pose as pycolmap's."""
    return pycolmap.Rigid3d(pycolmap.Rotation3d(matrix_from_quaternion(pose.rotation)[0]), pose.translation[0])


def _add_camera(model: Any, drive: StreetDrive, name: str, ids: dict[str, int]) -> int:
    import pycolmap

    lens = drive.cameras[name]
    ids["camera"] += 1
    parameters = [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px]
    model.add_camera(
        pycolmap.Camera(
            camera_id=ids["camera"], model="PINHOLE", width=lens.width_px, height=lens.height_px, params=parameters
        )
    )
    return ids["camera"]


def _add_rig(
    pycolmap: Any,
    model: Any,
    drive: StreetDrive,
    cameras: dict[str, int],
    ids: dict[str, int],
    *,
    stagger: bool = False,
) -> None:
    reference = next(iter(cameras))
    ids["rig"] += 1
    rig = pycolmap.Rig(rig_id=ids["rig"])
    for name, key in cameras.items():
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, key)
        if name == reference:
            rig.add_ref_sensor(sensor)
        else:
            camera_SE3_rig = drive.ego_SE3_camera[name].inverse() @ drive.ego_SE3_camera[reference]
            rig.add_sensor(sensor, rigid3d(pycolmap, camera_SE3_rig))
    model.add_rig(rig)
    for index, stamp in enumerate(drive.image_ns[reference].tolist()):
        ids["frame"] += 1
        world_SE3_rig = drive.poses_at(np.array([stamp])) @ drive.ego_SE3_camera[reference]
        frame = pycolmap.Frame(frame_id=ids["frame"], rig_id=ids["rig"])
        frame.rig_from_world = rigid3d(pycolmap, world_SE3_rig.inverse())
        images = []
        for key in cameras.values():
            ids["image"] += 1
            image = pycolmap.Image(image_id=ids["image"], camera_id=key, frame_id=ids["frame"], name=str(index))
            frame.add_data_id(image.data_id)
            images.append(image)
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
