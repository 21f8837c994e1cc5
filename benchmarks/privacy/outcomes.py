"""Findings of detectors in rendered images, beside the truth: a file with a line an image, to which lines are appended.

The file holds no pixels, and neither coverage nor the fallback: those are counted from it, so that other margins and
another fallback cost no rendering and no detection.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.synth_detectors.crowd import CrowdImage, Target
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.privacy.detectors.protocol import Detector
from mirror.privacy.regions import Kind, Region, merged
from mirror.schema.documents import Document
from mirror.schema.json_lines import append_line, read_lines
from mirror.schema.strict_json import decode_json
from mirror.synth.writing.boxes import world_SE3_boxes

_PEOPLE: Final = ("pedestrian", "person", "cyclist", "child")
_FARTHEST_M: Final = 60.0
_DECIMALS: Final = 4


class Thing(Document):
    """A face or plate of an image: bounds of the whole, and the share that is shown."""

    box_px: tuple[float, float, float, float]
    seen: float


class Vehicle(Document):
    """A vehicle's exact 3D box in the camera frame: pose (qw qx qy qz x y z, metres) and length, width, height."""

    camera_SE3_box: tuple[float, ...]
    size_m: tuple[float, float, float]
    category: str


class Outcome(Document):
    """The detections in one image, and its true objects.

    Attributes:
        series: `street` or `near`.
        seed: seed of the series.
        number: index of the image in its series.
        settings: digest of the detectors that searched it.
        width_px: width of the image.
        height_px: height.
        focal_px: focal length.
        faces: true faces.
        plates: true plates.
        vehicles: boxes of the vehicles within 60 m.
        regions: what the detectors found.
    """

    series: str
    seed: int
    number: int
    settings: str
    width_px: int
    height_px: int
    focal_px: float
    faces: tuple[Thing, ...]
    plates: tuple[Thing, ...]
    vehicles: tuple[Vehicle, ...]
    regions: tuple[Region, ...]

    @property
    def camera(self) -> Camera:
        """The camera of the image."""
        width, height = self.width_px, self.height_px
        return Camera("pinhole", width, height, self.focal_px, self.focal_px, 0.5 * width, 0.5 * height)

    @property
    def boxes(self) -> tuple[Poses, np.ndarray[Any, np.dtype[np.float64]], list[str]]:
        """Poses (N,) of the vehicles' boxes in the camera frame, their sizes (N, 3), and their categories."""
        rows = np.array([one.camera_SE3_box for one in self.vehicles], np.float64).reshape(-1, 7)
        sizes = np.array([one.size_m for one in self.vehicles], np.float64).reshape(-1, 3)
        return Poses(rows[:, :4], rows[:, 4:]), sizes, [one.category for one in self.vehicles]

    def things(self, kind: Kind) -> tuple[Thing, ...]:
        """Return the true regions of a kind."""
        return self.faces if kind == "face" else self.plates


def search_image(image: CrowdImage, detectors: Sequence[Detector], series: str, seed: int, number: int) -> Outcome:
    """Run the detectors on an image, and note the truth beside their regions."""
    rgb = np.ascontiguousarray(image.bgr[..., ::-1])
    users = [user for user in image.road_users if user.body.category not in _PEOPLE]
    poses = world_SE3_boxes(users, [user.motion.at(0.0) for user in users])
    in_camera = image.world_SE3_camera.inverse() @ poses
    rows = np.concatenate([in_camera.rotation, in_camera.translation], axis=1)
    vehicles = [
        Vehicle(camera_SE3_box=tuple(row.round(9).tolist()), size_m=user.body.size_m, category=user.body.category)
        for user, row in zip(users, rows)
        if np.linalg.norm(row[4:]) < _FARTHEST_M
    ]
    return Outcome(
        series=series, seed=seed, number=number, settings=settings_digest(detectors),
        width_px=rgb.shape[1], height_px=rgb.shape[0], focal_px=image.camera.fx_px,
        faces=_noted(image.faces), plates=_noted(image.plates), vehicles=tuple(vehicles),
        regions=tuple(merged([region for detector in detectors for region in detector(rgb)])),
    )  # fmt: skip


def settings_digest(detectors: Sequence[Detector]) -> str:
    """Return a digest of detectors: names, versions, weights, thresholds, and the source text of the built-in ones."""
    import mirror.privacy.detectors as package

    digest = hashlib.sha256()
    for one in detectors:
        digest.update(repr((one.kind, one.name, one.version, one.weights_sha256, one.threshold)).encode())
    for file in sorted(Path(str(package.__file__)).parent.glob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def read_outcomes(path: Path, settings: str) -> list[Outcome]:
    """Return the complete lines of a file that were made with these settings; a line that was cut off is left out."""
    outcomes = read_lines(path, lambda line: Outcome.model_validate(decode_json(line)))
    return [one for one in outcomes if one.settings == settings]


def append_outcome(path: Path, outcome: Outcome) -> None:
    """Add an image to a file."""
    append_line(path, outcome.model_dump_json())


def _noted(targets: Sequence[Target]) -> tuple[Thing, ...]:
    return tuple(
        Thing(box_px=tuple(one.box_px.round(_DECIMALS).tolist()), seen=round(one.seen, _DECIMALS)) for one in targets
    )
