"""The used images of the passes of a scene, their features on evened contrast, and which images to match."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Float64, Int64, UInt8
from mirror.calibration.refinement.features import ImageFeatures, find_features
from mirror.calibration.sampling import static_pixels
from mirror.calibration.tracking import TrackedImage
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.traversal import CameraCalibration
from mirror.errors import DatasetError, MirrorError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.localisation.alignment.options import AlignmentOptions
from mirror.schema.documents import Rig

_CLIP: float = 3.0
_TILES: int = 8


@dataclass
class PassImages:
    """The used images of one pass.

    Attributes:
        traversal_id: the pass.
        drive_id: its drive.
        stamps: times of its recorded poses.
        track: its recorded poses ``world_SE3_ego``.
        images: the images that could be read.
        features: their features.
        problem: why the pass is not used; None: it is.
        status: ``aligned`` until something prevents it: ``kept`` or ``failed``.
    """

    traversal_id: str
    drive_id: str
    stamps: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    track: Poses = field(default_factory=lambda: Poses.identity(0))
    images: list[Image] = field(default_factory=list)
    features: list[ImageFeatures] = field(default_factory=list)
    problem: str | None = None
    status: str = "aligned"

    def refuse(self, status: str, problem: str) -> None:
        """Take the pass out of the alignment."""
        self.status, self.problem = status, problem


def open_pass(view: Dataset, options: AlignmentOptions) -> tuple[PassImages, list[tuple[Frame, Image]]]:
    """Choose the images of a view of one traversal; an error is kept as the problem of the pass."""
    (row,) = view.table("traversals", ["traversal_id", "drive_id", "rig_id"]).to_pylist()
    one, chosen = PassImages(row["traversal_id"], row["drive_id"]), list[tuple[Frame, Image]]()
    try:
        frames = view.frames()
        if not frames:
            one.refuse("kept", "it has no images")
            return one, chosen
        one.stamps, one.track = frames[0].track
        names = options.cameras
        if not names:
            rig = view.store.json(f"rigs/{row['rig_id']}.json", Rig)
            names = (rig.reference_camera,)
        for name in names:
            last: Float64 | None = None
            for frame in frames:
                image = frame.images.get(name)
                if image is None:
                    continue
                place = image.world_SE3_camera.translation[0]
                if last is None or np.linalg.norm(place - last) >= 0.95 * options.step_m:
                    chosen.append((frame, image))
                    last = place
        if len(chosen) < 3:
            one.refuse("kept", f"{len(chosen)} images of {', '.join(names)} are {options.step_m:g} m apart")
    except MirrorError as error:
        one.refuse("failed", str(error))
    return one, chosen


def read_pass(
    one: PassImages, chosen: Sequence[tuple[Frame, Image]], features: int, advance: Callable[[int], None]
) -> None:
    """Find the features of the images of a pass; images that cannot be read are left out."""
    for frame, image in chosen:
        try:
            grey = even_contrast(image.decode())
            one.features.append(find_features(TrackedImage.from_grey(grey, static_pixels(frame, image)), features))
            one.images.append(image)
        except DatasetError as error:
            one.problem = str(error)
        except MirrorError as error:
            one.refuse("failed", str(error))
            return
        advance(1)
    if len(one.images) < 3:
        one.refuse("failed", one.problem or "its images cannot be read")
    else:
        one.problem = None


def even_contrast(rgb: UInt8) -> UInt8:
    """Return a grey image (H, W) whose contrast is evened out over tiles (CLAHE), so that light matters less."""
    import cv2

    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.createCLAHE(_CLIP, (_TILES, _TILES)).apply(grey), np.uint8)


@dataclass(frozen=True, eq=False)
class SceneImages:
    """The images of all passes of a scene, joined.

    Attributes:
        passes: the passes.
        number: (N,) number of the pass of each image.
        images: N images.
        features: N sets of features.
        ego_SE3_camera: N recorded mountings.
        world_SE3_camera: N recorded poses.
        camera: (N,) number of the calibration of each image.
        calibrations: the calibrations.
    """

    passes: Sequence[PassImages]
    number: Int64
    images: Sequence[Image]
    features: Sequence[ImageFeatures]
    ego_SE3_camera: Poses
    world_SE3_camera: Poses
    camera: Int64
    calibrations: Sequence[CameraCalibration]


def join_passes(passes: Sequence[PassImages]) -> SceneImages:
    """Join the images of some passes.

    Raises:
        DatasetError: the pose or calibration of an image is missing.
    """
    known: dict[tuple[str, str, int | None], int] = {}
    calibrations: list[CameraCalibration] = []
    number, camera, images, features, mountings, poses = [], [], [], [], [], []
    for place, one in enumerate(passes):
        for image, found in zip(one.images, one.features):
            used = image.calibration
            key = one.drive_id, image.camera, used.valid_from_ns
            if key not in known:
                known[key] = len(calibrations)
                calibrations.append(used)
            number.append(place)
            camera.append(known[key])
            images.append(image)
            features.append(found)
            mountings.append(used.ego_SE3_camera)
            poses.append(image.world_SE3_camera)
    return SceneImages(
        passes, np.array(number, np.int64), images, features, _stack(mountings), _stack(poses),
        np.array(camera, np.int64), calibrations,
    )  # fmt: skip


def _stack(poses: Sequence[Poses]) -> Poses:
    return Poses(np.concatenate([one.rotation for one in poses]), np.concatenate([one.translation for one in poses]))


def choose_partners(scene: SceneImages, options: AlignmentOptions) -> list[list[int]]:
    """Return for each image the later ones to match: the next of its pass, and those of other passes at its place.

    Recorded positions may be off by half of ``radius_m``; so the images of another pass are taken evenly from those
    within it, and not the nearest alone.
    """
    places = scene.world_SE3_camera.translation
    ways = matrix_from_quaternion(scene.world_SE3_camera.rotation)[:, :, 2]
    partners: list[set[int]] = [set() for _ in range(len(places))]
    for one in range(len(places)):
        same = np.flatnonzero((scene.number == scene.number[one]) & (np.arange(len(places)) > one))
        own = [other for other in same.tolist() if scene.images[other].camera == scene.images[one].camera]
        partners[one].update(own[: options.neighbours])
        apart = np.linalg.norm(places - places[one], axis=1)
        alike = ways @ ways[one] > np.cos(np.radians(options.angle_deg))
        for other in range(len(scene.passes)):
            near = np.flatnonzero((scene.number == other) & (apart < options.radius_m) & alike)
            if other == scene.number[one] or not len(near):
                continue
            nearest = near[np.argsort(apart[near], kind="stable")]
            spread = nearest[:: max(1, len(nearest) // options.partners)][: options.partners]
            for found in spread.tolist():
                partners[min(one, found)].add(max(one, found))
    return [sorted(found) for found in partners]
