"""Reads one scene for the refinement: its frames, the features of their images, and the recorded rigs."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from mirror.calibration.frame_choice import FrameChoice
from mirror.calibration.refinement.features import ImageFeatures, find_features
from mirror.calibration.refinement.rigs import MovingRigs
from mirror.calibration.sampling import choose_frames, declared_shutter, ego_twist, stack_poses, static_pixels
from mirror.calibration.tracking import TrackedImage
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.store import Store
from mirror.dataset.traversal import CameraCalibration
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.schema.documents import Rig
from mirror.schema.files import write_bytes

_PARTS: Final = ("uv_px", "scale_px", "descriptors")


@dataclass
class TraversalImages:
    """The used images of one traversal, with their features.

    Attributes:
        traversal_id: the traversal.
        vehicle_id: its vehicle.
        drive_id: its drive.
        reference: reference camera of its rig; None: it has no rig.
        frames: the chosen frames.
        images: the images that could be read, and the number of their frame.
        features: their features.
        unread: messages of images that could not be read.
        problem: why the traversal is not used; None: it is.
        status: ``refined`` until something prevents it: ``not refined`` (no motion, too few frames), or ``failed``.
    """

    traversal_id: str
    vehicle_id: str
    drive_id: str
    reference: str | None
    frames: list[Frame] = field(default_factory=list)
    images: list[tuple[int, Image]] = field(default_factory=list)
    features: list[ImageFeatures] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)
    problem: str | None = None
    status: str = "refined"


def open_traversal(view: Dataset, choice: FrameChoice) -> TraversalImages:
    """Choose the frames of a view of one traversal; an error is kept as the traversal's problem."""
    (row,) = view.table("traversals", ["traversal_id", "vehicle_id", "drive_id", "rig_id"]).to_pylist()
    reference = None
    if row["rig_id"] is not None:
        reference = view.store.json(f"rigs/{row['rig_id']}.json", Rig).reference_camera
    item = TraversalImages(row["traversal_id"], row["vehicle_id"], row["drive_id"], reference)
    try:
        item.frames = choose_frames(view, choice)
    except UsageError as error:
        item.status, item.problem = "not refined", str(error)
    except MirrorError as error:
        item.status, item.problem = "failed", str(error)
    return item


def read_features(item: TraversalImages, most: int, store: Store, work: Path, advance: Callable[[int], None]) -> None:
    """Find the features of a traversal's images, or read them from an interrupted run if the images are unchanged.

    Args:
        item: the traversal; gets images, features and the messages of unreadable images.
        most: largest number of features of an image.
        store: the dataset.
        work: folder of unfinished work, for the same masks, boxes and settings.
        advance: is called with 1 after each image.
    """
    hashes = ContentHashes(store)
    for number, frame in enumerate(item.frames):
        for name, image in sorted(frame.images.items()):
            try:
                file = work / f"{item.traversal_id}.{name}.{image.timestamp_ns}.{hashes.image(image)[:32]}.npz"
                features = _read_features(file) if file.is_file() else _find_features(frame, image, most, file)
                item.images.append((number, image))
                item.features.append(features)
            except DatasetError as error:
                item.unread.append(str(error))
            advance(1)
    if item.problem is None and not item.images:
        item.status, item.problem = "failed", "none of its images could be read"


def _find_features(frame: Frame, image: Image, most: int, file: Path) -> ImageFeatures:
    import cv2

    grey = np.asarray(cv2.cvtColor(image.decode(), cv2.COLOR_RGB2GRAY), np.uint8)
    found = find_features(TrackedImage.from_grey(grey, static_pixels(frame, image)), most)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **{name: getattr(found, name) for name in _PARTS})
    write_bytes(file, buffer.getvalue())
    return found


def _read_features(file: Path) -> ImageFeatures:
    with np.load(file, allow_pickle=False) as data:
        return ImageFeatures(*(data[name] for name in _PARTS))


@dataclass(frozen=True, eq=False)
class SceneRigs:
    """The rigs of a scene, and the camera of each mounting.

    Attributes:
        rigs: the recorded rigs.
        calibrations: K calibrations that the mountings start from.
        drives: K drives of the mountings.
        features: features of the images.
    """

    rigs: MovingRigs
    calibrations: Sequence[CameraCalibration]
    drives: Sequence[str]
    features: Sequence[ImageFeatures]


def gather_rigs(items: Sequence[TraversalImages]) -> SceneRigs:
    """Join the images of the traversals of one scene. A mounting is one calibration row of one drive's camera.

    Raises:
        DatasetError: poses or calibrations of an image are missing.
    """
    mountings: dict[tuple[str, str, int | None], int] = {}
    calibrations: list[CameraCalibration] = []
    drives: list[str] = []
    frame, mounting, poses, features, twists = [], [], [], [], []
    times: list[float] = []
    traversal: list[int] = []
    for number, item in enumerate(items):
        first = len(times)
        stamps = [one.timestamp_ns for one in item.frames]
        times += [(stamp - stamps[0]) * 1e-9 for stamp in stamps]
        traversal += [number] * len(stamps)
        for (place, image), found in zip(item.images, item.features):
            used = image.calibration
            key = item.drive_id, image.camera, used.valid_from_ns
            if key not in mountings:
                mountings[key] = len(mountings)
                calibrations.append(used)
                drives.append(item.drive_id)
            frame.append(first + place)
            mounting.append(mountings[key])
            poses.append(image.world_SE3_camera @ used.ego_SE3_camera.inverse())
            features.append(found)
            twists.append(ego_twist(item.frames[place], image.camera))
    rigs = MovingRigs(
        [one.model for one in calibrations],
        stack_poses([one.ego_SE3_camera for one in calibrations]), stack_poses(poses),
        np.array(frame, np.int64), np.array(mounting, np.int64), np.array(times), np.array(traversal, np.int64),
        np.array(twists).reshape(-1, 6), [declared_shutter(one) for one in calibrations],
    )  # fmt: skip
    return SceneRigs(rigs, calibrations, drives, features)
