"""A scene for the viewer rerun: cameras with images and masks, trajectories, boxes, points and conditions over time.

One frame is read, logged and forgotten after the other, so that memory does not grow with the scene. Rerun knows
pinholes only: images of distorted lenses are undistorted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.raster import ImageRaster, image_raster
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.installation import install_command
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.files import unwritable_error
from mirror.view.rerun_layout import make_layout
from mirror.view.rerun_program import open_viewer

LIGHT_COLOURS: Final = {"day": (240, 160, 20), "dusk": (190, 70, 160), "night": (60, 90, 220)}
_OTHER: Final = (140, 140, 140)
_MOST_POINTS: Final = 500_000
_JPEG_QUALITY: Final = 85
_IMAGE_PLANE_M: Final = 2.0
_PORT: Final = 9876
_MASK_COLOURS: Final = {
    "dynamic": (235, 70, 90), "ego": (60, 140, 235), "vehicle": (60, 140, 235), "sky": (90, 200, 235),
    "redaction": (250, 200, 60), "other": (120, 220, 120),
}  # fmt: skip
_CLASSES: Final = {kind: number for number, kind in enumerate(_MASK_COLOURS, start=1)}


@dataclass(frozen=True)
class RerunOptions:
    """Choice of the images of a dataset to log to rerun, and their width.

    Attributes:
        save: file to write (``.rrd``); None: the viewer is opened.
        width_px: images that are wider are scaled down.
        every: log every n-th frame.
    """

    save: Path | None = None
    width_px: int = 640
    every: int = 1


@dataclass(frozen=True)
class LoggedScene:
    """Counts of the logged images, boxes and layers of a scene.

    Attributes:
        frames: number of frames.
        images: number of images.
        boxes: number of boxes.
        points: number of points.
    """

    frames: int
    images: int
    boxes: int
    points: int


def log_scene(
    dataset: Dataset, scene: str, options: RerunOptions, *, progress: ProgressReporter | None = None
) -> LoggedScene:
    """Log a scene to rerun, and return the counts of what was logged.

    Timelines: ``time`` (Unix), ``elapsed`` since the entry of each traversal, so that traversals lie over each other,
    and ``frame``.

    Args:
        dataset: the view to log.
        scene: id of the scene.
        options: see `RerunOptions`.
        progress: receives the progress.

    Raises:
        UsageError: rerun is not installed, or there are several box layers and none was chosen.
        DatasetError: an image cannot be read, or the file cannot be written.
    """
    try:
        import rerun
    except ImportError as error:
        raise UsageError("this viewer needs rerun-sdk", remedy=install_command("view")) from error
    reporter = progress or NullProgress()
    view = dataset.where(scene=scene)
    recording = rerun.RecordingStream(f"mirror {scene}")
    temporary = None if options.save is None else options.save.with_name(f".{options.save.name}.tmp")
    if temporary is None:
        _open_viewer(recording)
    else:
        _open_file(recording, temporary)
    try:
        logger = _Logger(rerun, recording, options)
        recording.send_blueprint(make_layout(view))
        logger.log_static(view)
        rows = {row["traversal_id"]: row for row in view.table("traversals").to_pylist()}
        frames = view.frames()[:: options.every]
        reporter.start("frames", len(frames))
        for frame in frames:
            logger.log_frame(frame, rows[frame.traversal_id])
            reporter.advance(1)
        recording.flush()
        recording.disconnect()
        if temporary is not None and options.save is not None:
            temporary.replace(options.save)
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
    return LoggedScene(logger.frames, logger.images, logger.boxes, logger.points)


def _open_file(recording: Any, file: Path) -> None:
    """Begin to write the recording to a file."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
        recording.save(str(file))
    except OSError as error:
        raise unwritable_error(file, error) from error


def _open_viewer(recording: Any) -> None:
    """Open rerun's viewer and send it the recording."""
    open_viewer(_PORT)
    recording.connect_grpc()


class _Logger:
    """Logs to one recording."""

    def __init__(self, package: Any, recording: Any, options: RerunOptions) -> None:
        self._rr, self._recording, self._options = package, recording, options
        self._known: set[str] = set()
        self.frames = self.images = self.boxes = self.points = 0

    def log_static(self, view: Dataset) -> None:
        """Log what does not change: trajectories, points and the axes."""
        rr = self._rr
        self._log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        # Without colours of its own, 0 (nothing) is painted too.
        classes = [(0, "", (0, 0, 0, 0)), *((number, kind, _MASK_COLOURS[kind]) for kind, number in _CLASSES.items())]
        self._log("world", rr.AnnotationContext(classes), static=True)
        for row in view.table("traversals", ["traversal_id", "light", "weather"]).to_pylist():
            poses = view.where(traversal=row["traversal_id"]).table("ego_poses", ["tx_m", "ty_m", "tz_m"])
            line = np.stack([column.to_numpy() for column in poses.columns], axis=1)
            colour = LIGHT_COLOURS.get(row["light"], _OTHER)
            label = f"{row['light']}, {row['weather']}"
            self._log(
                f"world/trajectories/{row['traversal_id']}",
                rr.LineStrips3D([line], colors=[colour], labels=[label], show_labels=False),
                static=True,
            )
        if view.count("points"):
            points = view.points()
            step = max(1, -(-len(points) // _MOST_POINTS))
            self.points = len(points.position_m[::step])
            self._log("world/points", rr.Points3D(points.position_m[::step], colors=points.rgb[::step]), static=True)

    def log_frame(self, frame: Frame, row: Mapping[str, Any]) -> None:
        """Log the vehicle, the images and the boxes of a frame."""
        rr, base = self._rr, f"world/{frame.traversal_id}"
        self._recording.set_time("time", timestamp=np.datetime64(frame.timestamp_ns, "ns"))
        self._recording.set_time("elapsed", duration=(frame.timestamp_ns - row["entry_ns"]) / 1e9)
        self._recording.set_time("frame", sequence=frame.frame_index)
        self._log(f"{base}/ego", self._transform(frame.world_SE3_ego), rr.TransformAxes3D(1.0))
        if frame.frame_index == 0 or base not in self._known:
            self._known.add(base)
            self._log("conditions", rr.TextLog(f"{frame.traversal_id}: {row['light']}, {row['weather']}"))
        for image in frame.images.values():
            self._log_image(f"{base}/{image.camera}", image)
        self._log_boxes(f"{base}/boxes", frame, LIGHT_COLOURS.get(row["light"], _OTHER))
        self.frames += 1

    def _log_image(self, path: str, image: Image) -> None:
        rr = self._rr
        camera = image.camera_model
        factor = min(1.0, self._options.width_px / camera.width_px)
        raster = image_raster(camera, True, factor if factor < 1.0 else None)
        lens = raster.final
        self._log(
            path,
            self._transform(image.world_SE3_camera),
            rr.Pinhole(
                image_from_camera=lens.intrinsic_matrix(), width=lens.width_px, height=lens.height_px,
                camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=_IMAGE_PLANE_M,
            ),
        )  # fmt: skip
        self._log(f"{path}/image", rr.EncodedImage(contents=_encoded(image, raster), media_type="image/jpeg"))
        for kind, pixels in _masks(image, raster):
            self._log(f"{path}/masks/{kind}", rr.SegmentationImage(pixels))
        self.images += 1

    def _log_boxes(self, path: str, frame: Frame, colour: tuple[int, int, int]) -> None:
        boxes = frame.boxes("world")
        if not len(boxes):
            self._log(path, self._rr.Clear(recursive=False))
            return
        w, x, y, z = boxes.pose.rotation.T
        self._log(
            path,
            self._rr.Boxes3D(
                centers=boxes.pose.translation, half_sizes=0.5 * boxes.size_m,
                quaternions=np.stack([x, y, z, w], axis=1), labels=list(boxes.category), show_labels=False,
                colors=[colour],
            ),
        )  # fmt: skip
        self.boxes += len(boxes)

    def _transform(self, pose: Poses) -> Any:
        w, x, y, z = pose.rotation[0].tolist()
        return self._rr.Transform3D(translation=pose.translation[0], quaternion=self._rr.Quaternion(xyzw=[x, y, z, w]))

    def _log(self, path: str, *what: Any, static: bool = False) -> None:
        self._recording.log(path, *what, static=static)


def _encoded(image: Image, raster: ImageRaster) -> bytes:
    """JPEG bytes of an image: its own where nothing is changed."""
    if raster.final == raster.recorded and image.codec == "jpeg" and image.video_pts is None:
        return image.read()
    pixels = raster.image(image.decode())
    return cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def _masks(image: Image, raster: ImageRaster) -> Iterator[tuple[str, UInt8]]:
    """Masks by kind; their values are the classes that the viewer colours."""
    for mask in image.masks():
        yield mask.kind, _class_of(mask.kind, raster.mask(mask.decode()))
    static = image.static_mask()
    if static is not None:
        yield "vehicle", _class_of("vehicle", raster.mask(static))


def _class_of(kind: str, mask: UInt8) -> UInt8:
    return np.where(mask > 0, _CLASSES.get(kind, len(_CLASSES)), 0).astype(np.uint8)
