"""COLMAP 4: cameras, rigs, frames, images and points as the binary files of a sparse model.

A rig of COLMAP is rigid: all cameras of a frame have the vehicle's pose at one instant. Cameras of a MIRROR rig may be
exposed at different instants of a frame. Where that displaces a camera of a traversal by more than a hundredth of a
pixel could show, each of its cameras becomes a rig of its own, so that every image keeps its own pose.

Source: https://colmap.github.io/format.html, https://colmap.github.io/rigs.html
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from mirror.dataset.frames import Frame
from mirror.dataset.traversal import CameraCalibration
from mirror.errors import UsageError
from mirror.export.layout import ExportLayout, Kept, Written
from mirror.export.lenses import LensMap, colmap_lens
from mirror.export.scene import ExportImage, ExportScene
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.installation import install_command
from mirror.progress import ProgressReporter

if TYPE_CHECKING:
    import pycolmap

RIGID_M: Final = 2e-5
"""Largest displacement of a camera in a rig: below a hundredth of a pixel at 2 m and a focal length of 1,000 px."""

RIGID_RAD: Final = 2e-6
"""Largest rotation of a camera in a rig: two thousandths of a pixel at a focal length of 1,000 px."""

Sensor: TypeAlias = tuple[str, Camera, tuple[float, ...]]
"""A camera's name, lens and mounting."""


@dataclass
class _Segment:
    """Consecutive frames of a traversal with the same calibrations."""

    sensors: dict[str, Sensor] = field(default_factory=dict)
    frames: list[tuple[Frame, list[ExportImage]]] = field(default_factory=list)

    def takes(self, sensors: Mapping[str, Sensor]) -> bool:
        return all(self.sensors.get(camera, sensor) == sensor for camera, sensor in sensors.items())


def write_sparse_model(scene: ExportScene, folder: Path, lens_of: LensMap) -> Written:
    """Write the sparse COLMAP model of a scene.

    Args:
        scene: what is exported.
        folder: folder of the files ``cameras.bin``, ``rigs.bin``, ``frames.bin``, ``images.bin``, ``points3D.bin``.
        lens_of: the camera models that may be used.

    Raises:
        UsageError: pycolmap is not installed.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise UsageError("COLMAP models need pycolmap", remedy=install_command("calibration")) from error
    model = _Model(pycolmap, lens_of, scene.origin_m)
    rigid = 0
    traversals = list(scene.by_traversal())
    for _, frames in traversals:
        segments = _segments(frames)
        is_rigid = all(_is_rigid(segment) for segment in segments)
        rigid += is_rigid
        for segment in segments:
            if is_rigid:
                model.add_rigid(segment)
            else:
                model.add_separate(segment)
    if scene.points is not None:
        model.add_points(scene.points.position_m, scene.points.rgb)
    folder.mkdir(parents=True, exist_ok=True)
    model.reconstruction.write_binary(str(folder))
    apart = f"{len(traversals) - rigid} of {len(traversals)} traversals"
    note = f"each camera of {apart} is a rig of its own, because the cameras are exposed at different instants"
    return Written(
        tuple(sorted(folder.glob("*.bin"))),
        points=0 if scene.points is None else len(scene.points),
        notes=() if rigid == len(traversals) else (note,),
    )


class _Model:
    """A reconstruction of pycolmap that is being filled."""

    def __init__(self, package: Any, lens_of: LensMap, origin_m: np.ndarray) -> None:
        self.reconstruction: pycolmap.Reconstruction = package.Reconstruction()
        self._package = package
        self._lens_of = lens_of
        self._origin = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), -origin_m[None])
        self._rigs: dict[tuple[Sensor, ...], tuple[int, dict[str, int]]] = {}
        self._images = 0
        self._frames = 0

    def add_rigid(self, segment: _Segment) -> None:
        """Add frames whose cameras move as one rig."""
        sensors = tuple(segment.sensors.values())
        rig_id, cameras = self._rig(sensors)
        reference = _mounting(sensors[0])
        for frame, images in segment.frames:
            self._add_frame(rig_id, self._origin @ frame.world_SE3_ego @ reference, images, cameras)

    def add_separate(self, segment: _Segment) -> None:
        """Add each image as a frame of a rig with one camera."""
        for _, images in segment.frames:
            for item in images:
                rig_id, cameras = self._rig((segment.sensors[item.image.camera],))
                self._add_frame(rig_id, self._origin @ item.world_SE3_camera, [item], cameras)

    def add_points(self, position_m: np.ndarray, rgb: np.ndarray) -> None:
        """Add points without tracks."""
        track = self._package.Track()
        for position, colour in zip(position_m + self._origin.translation, rgb):
            self.reconstruction.add_point3D(position, track, colour)

    def _add_frame(
        self, rig_id: int, world_SE3_reference: Poses, images: Sequence[ExportImage], cameras: Mapping[str, int]
    ) -> None:
        self._frames += 1
        frame = self._package.Frame(frame_id=self._frames, rig_id=rig_id)
        frame.rig_from_world = self._rigid3d(world_SE3_reference.inverse())
        added = []
        for item in images:
            self._images += 1
            image = self._package.Image(
                image_id=self._images, camera_id=cameras[item.image.camera], frame_id=self._frames, name=item.name
            )
            frame.add_data_id(image.data_id)
            added.append(image)
        self.reconstruction.add_frame(frame)
        for image in added:
            self.reconstruction.add_image(image)

    def _rig(self, sensors: tuple[Sensor, ...]) -> tuple[int, dict[str, int]]:
        """The id of a rig, and the ids of its cameras by name; equal rigs are written once."""
        known = self._rigs.get(sensors)
        if known is not None:
            return known
        cameras = {}
        rig = self._package.Rig(rig_id=len(self._rigs) + 1)
        for sensor in sensors:
            camera = self._camera(sensor[1])
            self.reconstruction.add_camera(camera)
            cameras[sensor[0]] = int(camera.camera_id)
            if len(cameras) == 1:
                rig.add_ref_sensor(camera.sensor_id)
            else:
                from_rig = _mounting(sensor).inverse() @ _mounting(sensors[0])
                rig.add_sensor(camera.sensor_id, self._rigid3d(from_rig))
        self.reconstruction.add_rig(rig)
        self._rigs[sensors] = (int(rig.rig_id), cameras)
        return self._rigs[sensors]

    def _camera(self, camera: Camera) -> pycolmap.Camera:
        lens = self._lens_of(camera)
        if lens is None:
            raise UsageError(f"no model of COLMAP has the projection of {camera.model}", remedy="give --undistort")
        params = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *lens.coefficients.values()]
        return self._package.Camera(
            camera_id=self.reconstruction.num_cameras() + 1, model=lens.model,
            width=camera.width_px, height=camera.height_px, params=params,
        )  # fmt: skip

    def _rigid3d(self, pose: Poses) -> pycolmap.Rigid3d:
        w, x, y, z = pose.rotation[0]
        return self._package.Rigid3d(self._package.Rotation3d(np.array([x, y, z, w])), pose.translation[0])


def _segments(frames: Sequence[tuple[Frame, list[ExportImage]]]) -> list[_Segment]:
    """Cut a traversal's frames where the calibration of a camera changes."""
    segments = [_Segment()]
    for frame, images in frames:
        sensors = {item.image.camera: _sensor(item, item.image.calibration) for item in images}
        if not segments[-1].takes(sensors):
            segments.append(_Segment())
        segments[-1].sensors.update(sensors)
        segments[-1].frames.append((frame, images))
    return segments


def _sensor(item: ExportImage, calibration: CameraCalibration) -> Sensor:
    mounting = calibration.ego_SE3_camera
    return item.image.camera, item.lens, to_pose_numbers(mounting)


def _mounting(sensor: Sensor) -> Poses:
    return Poses(np.array([sensor[2][:4]]), np.array([sensor[2][4:]]))


def _is_rigid(segment: _Segment) -> bool:
    """Return whether the poses of all images follow from the vehicle's poses at the instants of their frames."""
    for frame, images in segment.frames:
        ego = frame.world_SE3_ego
        for item in images:
            rigid = ego @ _mounting(segment.sensors[item.image.camera])
            twist = (rigid.inverse() @ item.world_SE3_camera).log()[0]
            if np.linalg.norm(twist[:3]) > RIGID_RAD or np.linalg.norm(twist[3:]) > RIGID_M:
                return False
    return True


def _write(scene: ExportScene, out: Path, _: ProgressReporter) -> Written:
    return write_sparse_model(scene, out / "sparse" / "0", colmap_lens)


KEPT: Final = (
    Kept("pose of each image", "frames.bin, rigs.bin", "1e-9 m, 1e-12 rad; in a rig 2e-5 m, 2e-6 rad"),
    Kept("focal lengths, principal point, distortion", "cameras.bin", "exact"),
    Kept("position of points", "points3D.bin", "exact"),
    Kept("colour of points", "points3D.bin", "exact"),
    Kept("traversal, camera, time of each image", "the name in images.bin", "exact"),
    Kept("masks of what is not the static street", "masks/", "exact"),
    Kept("roles of a split", "splits/", "exact"),
)
LOST: Final = (
    "boxes and their tracks",
    "depth maps, lidar sweeps",
    "exposure, rolling shutter and time offsets",
    "the geodetic reference of the world frame",
    "kind and standard deviation of points, and which traversal observed them",
    "calibration stages, validity and covariance",
    "poses between images",
    "light and weather",
)

LAYOUT: Final = ExportLayout(
    name="colmap",
    title="COLMAP 4 sparse model",
    lens_of=colmap_lens,
    image_path=lambda item: f"images/{item.name}",
    mask_path=lambda item: f"masks/{item.name}.png",
    needs_all_masks=False,
    write=_write,
    kept=KEPT,
    lost=LOST,
    holds_points=True,
)
