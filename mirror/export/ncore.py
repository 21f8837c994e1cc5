"""NVIDIA NCore V4: one store ``TRAVERSAL.ncore4.zarr.itar`` a traversal, by the package ``nvidia-ncore``.

A sequence has the poses ``rig`` in ``world`` at whole microseconds, the pose of the scene's world in the earth's frame
where it has one, cameras with lens, shutter, mounting and static mask, images with start and end of their exposure and
with a mask of what is not the static street (``valid_mask_png`` of their generic data), and boxes in the rig's frame at
their own time. gsplat, 3DGRUT, NuRec and AlpaSim read such stores, and so does the reader ``ncore``.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.frames import Frame
from mirror.errors import DatasetError, UsageError
from mirror.export.files import encode_image, image_bytes
from mirror.export.layout import ExportLayout, Kept, Written
from mirror.export.lenses import ForeignLens
from mirror.export.ncore_lenses import lens_error_px, to_ncore
from mirror.export.scene import ExportImage, ExportScene
from mirror.geometry import Poses, interpolate, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.geometry.geodesy import ecef_R_enu, geodetic_to_ecef
from mirror.installation import install_command
from mirror.progress import ProgressReporter
from mirror.recordings.readers.ncore_lenses import to_camera

_LARGEST_PX: Final = 0.1
_US: Final = 1_000

Frames = Sequence[tuple[Frame, list[ExportImage]]]


def _store_name(traversal_id: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]", "_", traversal_id)


def _image_path(item: ExportImage) -> str:
    return f"{_store_name(item.frame.traversal_id)}.ncore4.zarr.itar"


def _lens(camera: Camera) -> ForeignLens | None:
    """Return a word for the lens: NCore has all models."""
    return ForeignLens(camera.model, {})


def _require(scene: ExportScene) -> None:
    """Refuse, before anything is written, what a store cannot hold."""
    try:
        import ncore.data.v4  # noqa: F401
    except ImportError as error:
        raise UsageError("NCore stores need the package nvidia-ncore", remedy=install_command("ncore")) from error
    for item in scene.images:
        if item.image.video_pts is None and item.image.codec not in ("jpeg", "png"):
            raise UsageError(f"an image of the kind {item.image.codec}", expected="JPEG, PNG or frames of videos")


def _write(scene: ExportScene, out: Path, progress: ProgressReporter) -> Written:
    progress.start("stores", len(scene.images))
    files, boxes, masks, notes = [], 0, 0, list[str]()
    for traversal_id, frames in scene.by_traversal():
        store = _Store(scene, traversal_id, frames, progress)
        files.append(store.write(out))
        boxes, masks = boxes + store.boxes, masks + store.masks
        notes += store.notes
    return Written(tuple(files), boxes=boxes, masks=masks, notes=tuple(dict.fromkeys(notes)))


class _Store:
    """The store of one traversal."""

    def __init__(self, scene: ExportScene, traversal_id: str, frames: Frames, progress: ProgressReporter) -> None:
        self.scene, self.traversal_id, self.frames, self.progress = scene, traversal_id, frames, progress
        self.name = _store_name(traversal_id)
        self.boxes = self.masks = 0
        self.notes: list[str] = []

    def write(self, out: Path) -> Path:
        """Write the store; it gets its name when it is complete."""
        from ncore.data.v4 import PosesComponent, SequenceComponentGroupsWriter
        from ncore.impl.common.transformations import HalfClosedInterval
        from upath import UPath

        stamps, track = self.frames[0][0].track
        # At whole microseconds, so that no position moves with its stamp.
        times = np.unique(np.concatenate([-(-stamps[:1] // _US), stamps[1:-1] // _US, stamps[-1:] // _US]))
        times = times[(times * _US >= stamps[0]) & (times * _US <= stamps[-1])]
        poses = interpolate(stamps, track, times * _US)
        interval = HalfClosedInterval.from_start_end(int(times[0]), int(times[-1]))
        work = out / f".{self.name}.part"
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        try:
            writer = SequenceComponentGroupsWriter(UPath(work), self.name, self.name, interval, {}, "itar")
            component = writer.register_component_writer(PosesComponent.Writer, "default")
            component.store_dynamic_pose("rig", "world", _matrices(poses), times.astype(np.uint64))
            place = _global_from_world(self.scene)
            if place is not None:
                component.store_static_pose("world", "world_global", place)
            self._write_cameras(writer, component)
            self._write_boxes(writer)
            (made,) = (Path(str(path)) for path in writer.finalize())
            target = out / f"{self.name}.ncore4.zarr.itar"
            made.replace(target)
        except OSError as error:
            raise DatasetError(f"cannot be written: {error}", file=out) from error
        finally:
            shutil.rmtree(work, ignore_errors=True)
        return target

    def _by_camera(self) -> dict[str, list[ExportImage]]:
        found: dict[str, list[ExportImage]] = {}
        for _, images in self.frames:
            for item in images:
                found.setdefault(item.image.camera, []).append(item)
        return found

    def _write_cameras(self, writer: Any, poses: Any) -> None:
        from ncore.data.v4 import CameraSensorComponent, IntrinsicsComponent, MasksComponent
        from PIL import Image

        intrinsics = writer.register_component_writer(IntrinsicsComponent.Writer, "default")
        masks = writer.register_component_writer(MasksComponent.Writer, "default")
        for name, items in self._by_camera().items():
            first = items[0]
            self._require_one_calibration(name, items)
            lens = to_ncore(first.lens, first.image.calibration.row["shutter_direction"])
            error = lens_error_px(first.lens, to_camera(lens, Path(self.name), name)[0])
            if error > _LARGEST_PX:
                raise UsageError(
                    f"the lens {first.lens.model} is {error:.2g} px off in NCore's numbers", place=f"camera {name}",
                    expected=f"at most {_LARGEST_PX:g} px",
                    remedy="give --undistort: images of such cameras are then resampled to pinhole cameras",
                )  # fmt: skip
            self.notes.append(f"camera {name}: {lens.type()}, at most {error:.3f} px from the dataset's lens")
            poses.store_static_pose(name, "rig", _matrices(first.image.calibration.ego_SE3_camera)[0])
            intrinsics.store_camera_intrinsics(name, lens)
            static = first.image.static_mask()
            hidden = np.zeros((first.lens.height_px, first.lens.width_px), np.uint8)
            if static is not None:
                hidden = np.where(first.raster.mask(static) != 0, 255, 0).astype(np.uint8)
            masks.store_camera_masks(name, {"ego": Image.fromarray(hidden)})
            images = writer.register_component_writer(CameraSensorComponent.Writer, name, None)
            for item in items:
                start = item.image.exposure_start_ns // _US
                end = max(item.image.exposure_end_ns // _US, start)
                valid, generic = item.valid_pixels(), dict[str, Any]()
                if valid is not None:
                    generic["valid_mask_png"] = np.frombuffer(encode_image(valid, ".png"), np.uint8)
                    self.masks += 1
                data = image_bytes(item, item.suffix)
                kind = "jpeg" if item.suffix == ".jpg" else "png"
                images.store_frame(data, kind, np.array([start, end], np.uint64), generic, {})
                self.progress.advance(1)

    def _require_one_calibration(self, name: str, items: Sequence[ExportImage]) -> None:
        if len({(item.image.calibration.valid_from_ns, item.lens) for item in items}) > 1:
            self.notes.append(f"camera {name}: its calibration changes within a traversal; the first one is written")

    def _write_boxes(self, writer: Any) -> None:
        from ncore.data import BBox3, CuboidTrackObservation, LabelSource
        from ncore.data.v4 import CuboidsComponent

        seen: set[tuple[str, int]] = set()
        rows = []
        for frame in self._annotated():
            boxes = frame.boxes()
            at = boxes.timestamp_ns // _US
            turns = matrix_from_quaternion(boxes.pose.rotation) if len(boxes) else np.empty((0, 3, 3))
            for number, track in enumerate(boxes.track_id):
                if (track, at) in seen:
                    continue
                seen.add((track, at))
                turn = turns[number]
                angles = np.array(
                    [
                        np.arctan2(turn[2, 1], turn[2, 2]),
                        np.arcsin(np.clip(-turn[2, 0], -1.0, 1.0)),
                        np.arctan2(turn[1, 0], turn[0, 0]),
                    ]
                )
                place, size = boxes.pose.translation[number], boxes.size_m[number]
                rows.append(
                    CuboidTrackObservation(
                        track_id=track, class_id=boxes.category[number], timestamp_us=int(at),
                        reference_frame_id="rig", reference_frame_timestamp_us=int(at),
                        bbox3=BBox3(_three(place), _three(size), _three(angles)),
                        source=LabelSource.EXTERNAL, source_version=boxes.source[number],
                    )
                )  # fmt: skip
        if rows:
            writer.register_component_writer(CuboidsComponent.Writer, "default", None).store_observations(rows)
        self.boxes = len(rows)

    def _annotated(self) -> Iterator[Frame]:
        for frame, _ in self.frames:
            if len(frame.boxes()):
                yield frame


def _three(values: Float64) -> tuple[float, float, float]:
    first, second, third = values.tolist()
    return first, second, third


def _matrices(poses: Poses) -> Float64:
    """Return matrices (N, 4, 4) whose last row is exact."""
    return np.asarray(poses.matrix(), np.float64)


def _global_from_world(scene: ExportScene) -> Float64 | None:
    """Return the pose (4, 4) of the scene's world in the earth-centred, earth-fixed frame; None: it has no place."""
    row = scene.scene
    if row["longitude_deg"] is None:
        return None
    lon, lat, height = row["longitude_deg"], row["latitude_deg"], row["height_m"] or 0.0
    pose = np.eye(4)
    pose[:3, :3] = ecef_R_enu(lon, lat)
    pose[:3, 3] = geodetic_to_ecef(lon, lat, height)
    return pose


LAYOUT: Final = ExportLayout(
    name="ncore",
    title="NVIDIA NCore V4",
    lens_of=_lens,
    image_path=_image_path,
    mask_path=None,
    needs_all_masks=False,
    write=_write,
    require=_require,
    holds_images=True,
    kept=(
        Kept("pose of each image", "poses, rig in world", "1e-5 m, 1e-6 rad"),
        Kept("mounting of the cameras", "poses, camera in rig", "1e-6 m"),
        Kept("lens", "intrinsics", "0.1 px; the error of the fit is a note of the export"),
        Kept("exposure, rolling shutter", "frames", "1 us"),
        Kept("image bytes", "frames", "exact, unless undistorted"),
        Kept("boxes and tracks", "cuboids", "1e-5 m, 1e-5 rad"),
        Kept("static masks", "masks", "exact"),
        Kept("masks of road users", "generic data of a frame: valid_mask_png", "exact"),
        Kept("the geodetic reference of the world frame", "poses, world in world_global", "1e-6 m"),
    ),
    lost=(
        "scores and velocities of boxes",
        "depth maps, points",
        "lidar sweeps",
        "calibrations that change within a traversal",
        "time offsets of the cameras",
        "light and weather",
    ),
)
