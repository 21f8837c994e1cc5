"""Writes drives as NCore V4 stores with the package ``nvidia-ncore``, whose writer defines the layout."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyproj

from mirror.geometry.poses import Poses
from tests.recordings.formats.street import StreetDrive
from tests.recordings.formats.waymo import matrices

EXPOSURE_US = 16_000
PLACE = (8.4447, 49.0183, 115.0)
VERSION = "labels-3"


def ecef_from_world() -> np.ndarray:
    """(4, 4) pose of the east-north-up world of `PLACE` in the earth's frame; PROJ gives the axes."""
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    lon, lat = np.radians(PLACE[:2])
    out = np.eye(4)
    out[:3, 0] = (-np.sin(lon), np.cos(lon), 0.0)
    out[:3, 1] = (-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat))
    out[:3, 2] = (np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat))
    out[:3, 3] = to_ecef.transform(*PLACE)
    return out


def default_lens(drive: StreetDrive, name: str) -> Any:
    """The drive's pinhole, as the OpenCV model without distortion."""
    from ncore.data import OpenCVPinholeCameraModelParameters, ShutterType

    lens = drive.cameras[name]
    zeros = {"radial_coeffs": 6, "tangential_coeffs": 2, "thin_prism_coeffs": 4}
    return OpenCVPinholeCameraModelParameters(
        resolution=np.array([lens.width_px, lens.height_px], np.uint64),
        shutter_type=ShutterType.ROLLING_TOP_TO_BOTTOM,
        principal_point=np.array([lens.cx_px, lens.cy_px], np.float32),
        focal_length=np.array([lens.fx_px, lens.fy_px], np.float32),
        **{key: np.zeros(count, np.float32) for key, count in zeros.items()},
    )


def write_ncore(
    root: Path,
    drives: Sequence[StreetDrive],
    *,
    store_type: Literal["itar", "directory"] = "itar",
    groups: bool = False,
    world_global: np.ndarray | None = None,
    lens: Any = default_lens,
    box_frame: str = "rig",
    late_us: int = 0,
    tear_pose: int | None = None,
    pickled_image: Path | None = None,
    compressed_image: bool = False,
) -> Path:
    """Write a sequence for each drive, and return the folder. The drives' world is the sequence's.

    Args:
        root: the folder.
        drives: what to write.
        store_type: indexed tar files, or folders.
        groups: images and boxes in stores of their own.
        world_global: pose of the world in the global frame; None: it is not stated.
        lens: gives the parameters of a drive's camera.
        box_frame: the frame of the boxes: ``rig``, a camera's name, or ``world``.
        late_us: how much later than a box's own stamp its frame is taken.
        tear_pose: the number of a pose that is written without a rotation.
        pickled_image: the first image of the first camera is pickled, and creates this file where it is unpickled.
        compressed_image: the first image of the first camera has a codec.
    """
    from ncore.data import BBox3, CuboidTrackObservation, LabelSource
    from ncore.data.v4 import (
        CameraSensorComponent,
        CuboidsComponent,
        IntrinsicsComponent,
        MasksComponent,
        PosesComponent,
        SequenceComponentGroupsReader,
        SequenceComponentGroupsWriter,
    )
    from ncore.impl.common.transformations import HalfClosedInterval
    from PIL import Image
    from upath import UPath

    for drive in drives:
        stamps = drive.pose_ns // 1_000
        interval = HalfClosedInterval.from_start_end(int(stamps[0]) - 20_000, int(stamps[-1]) + 20_000)
        writer = SequenceComponentGroupsWriter(UPath(root), drive.name, drive.name, interval, {}, store_type)
        poses = writer.register_component_writer(PosesComponent.Writer, "default")
        trajectory = matrices(drive.poses)
        if tear_pose is not None:
            trajectory[tear_pose, :3, :3] = 0.0
        poses.store_dynamic_pose(
            "rig", "world", trajectory, stamps.astype(np.uint64), require_sequence_time_coverage=False
        )
        if world_global is not None:
            poses.store_static_pose("world", "world_global", world_global)
        intrinsics = writer.register_component_writer(IntrinsicsComponent.Writer, "default")
        masks = writer.register_component_writer(MasksComponent.Writer, "default")
        for name, camera in drive.cameras.items():
            poses.store_static_pose(name, "rig", matrices(drive.ego_SE3_camera[name])[0])
            intrinsics.store_camera_intrinsics(name, lens(drive, name))
            mask = np.zeros((camera.height_px, camera.width_px), np.uint8)
            mask[-3:] = 255
            masks.store_camera_masks(name, {"ego": Image.fromarray(mask)})
            images = writer.register_component_writer(CameraSensorComponent.Writer, name, "cameras" if groups else None)
            for index, middle_ns in enumerate(drive.image_ns[name]):
                half = EXPOSURE_US // 2
                frame = np.array([middle_ns // 1_000 - half, middle_ns // 1_000 + half], np.uint64)
                images.store_frame(drive.image(name, index), "jpeg", frame, {}, {})
                if index == 0 and name == next(iter(drive.cameras)):
                    first = images._group["frames"][str(frame[1])]
                    if pickled_image is not None:
                        _pickle_image(first, pickled_image)
                    if compressed_image:
                        _compress_image(first)
        cuboids = writer.register_component_writer(CuboidsComponent.Writer, "default", "labels" if groups else None)
        seen = []
        for one in drive.objects:
            at_ns = np.minimum(drive.box_ns + late_us * 1_000, drive.pose_ns[-1])
            frame = _frame_at(drive, at_ns, box_frame)
            placed = matrices(frame.inverse() @ one.world_SE3_box)
            for stamp, late, matrix in zip(drive.box_ns, at_ns, placed):
                rotation = matrix[:3, :3]
                seen.append(
                    CuboidTrackObservation(
                        track_id=one.track_id,
                        class_id=one.category,
                        timestamp_us=int(stamp) // 1_000,
                        reference_frame_id=box_frame,
                        reference_frame_timestamp_us=int(late) // 1_000,
                        bbox3=BBox3(
                            centroid=tuple(float(value) for value in matrix[:3, 3]),
                            dim=tuple(float(value) for value in one.size_m),
                            rot=(
                                float(np.arctan2(rotation[2, 1], rotation[2, 2])),
                                float(np.arcsin(-rotation[2, 0])),
                                float(np.arctan2(rotation[1, 0], rotation[0, 0])),
                            ),
                        ),
                        source=LabelSource.GT_SYNTHETIC,
                        source_version=VERSION,
                    )
                )
        cuboids.store_observations(seen)
        paths = writer.finalize()
        meta = SequenceComponentGroupsReader(paths).get_sequence_meta()
        (root / f"{drive.name}.json").write_text(meta.to_json())
    return root


def _pickle_image(group: Any, mark: Path) -> None:
    import numcodecs

    del group["image"]
    array = group.create_dataset("image", shape=(1,), dtype=object, object_codec=numcodecs.Pickle(), compressor=None)
    array.attrs["format"] = "jpeg"
    array[:] = np.array([_Touch(mark)], object)


def _compress_image(group: Any) -> None:
    import numcodecs

    encoded = group["image"][()].reshape(1)  # an array without axes keeps no codec
    del group["image"]
    array = group.create_dataset("image", data=encoded, compressor=numcodecs.Zlib())
    array.attrs["format"] = "jpeg"


class _Touch:
    """Creates a file where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __reduce__(self) -> Any:
        return Path.touch, (self._mark,)


def _frame_at(drive: StreetDrive, stamps_ns: np.ndarray, frame: str) -> Poses:
    if frame == "world":
        count = len(stamps_ns)
        return Poses(np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)), np.zeros((count, 3)))
    ego = drive.poses_at(stamps_ns)
    return ego if frame == "rig" else ego @ drive.ego_SE3_camera[frame]
