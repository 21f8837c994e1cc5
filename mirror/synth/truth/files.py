"""The folder ``truth`` of a recording: its document, and a reader."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import pyarrow as pa

from mirror.arrays import AnyArray
from mirror.recordings.calibration import Calibration
from mirror.recordings.folder_document import read_calibrations
from mirror.schema.documents import Document, Roi
from mirror.schema.files import read_json, read_table, write_json
from mirror.synth.model import Label
from mirror.synth.truth.images import Kind, read_truth_image
from mirror.synth.truth.tables import BOXES, POSES

FOLDER: Final = "truth"


class TruthObject(Document):
    """One road user of a recording.

    Attributes:
        track_id: track id, as in ``boxes.parquet``.
        category: class of the road user.
    """

    track_id: str
    category: str


class TruthDocument(Document):
    """``truth.json``: the exact truth of a synthetic recording.

    Attributes:
        scene: the scene; the east-north-up frame at its centre is the world frame.
        kinds: kinds of image truth in the folder.
        labels: values of the semantic masks, by name.
        objects: road users; the k-th, counting from 1, has the value k in the instance masks.
    """

    format: Literal["mirror-truth"] = "mirror-truth"
    version: Literal["1.0"] = "1.0"
    scene: Roi
    kinds: tuple[Kind, ...]
    labels: dict[str, int]
    objects: tuple[TruthObject, ...]


@dataclass(frozen=True)
class Truth:
    """A reader of the ground truth of one recording.

    Args:
        recording: folder of the recording.

    Raises:
        DatasetError: the recording has no truth.
    """

    recording: Path

    @property
    def folder(self) -> Path:
        """The folder of the truth."""
        return self.recording / FOLDER

    @cached_property
    def document(self) -> TruthDocument:
        """The document ``truth.json``."""
        return read_json(self.folder / "truth.json", TruthDocument)

    def poses(self) -> pa.Table:
        """Read the exact poses of the vehicle and of all images: `mirror.synth.truth.tables.POSES`."""
        return read_table(self.folder / "poses.parquet", POSES)

    def boxes(self) -> pa.Table:
        """Read the exact boxes of each image with their visibility: `mirror.synth.truth.tables.BOXES`."""
        return read_table(self.folder / "boxes.parquet", BOXES)

    def calibrations(self) -> list[Calibration]:
        """Read the true calibrations of the cameras."""
        return read_calibrations(self.folder / "calibrations.json")

    def read(self, kind: Kind, camera: str, timestamp_ns: int) -> AnyArray:
        """Read the truth of one image, by its recorded timestamp; see `mirror.synth.truth.images.KINDS`.

        Raises:
            RecordingError: the file is missing or broken.
        """
        return read_truth_image(self.folder, kind, camera, timestamp_ns)


def write_document(
    recording: Path, scene: Roi, kinds: tuple[Kind, ...], objects: tuple[TruthObject, ...]
) -> TruthDocument:
    """Write ``truth.json``."""
    labels = {label.name.lower(): int(label) for label in Label}
    document = TruthDocument(scene=scene, kinds=kinds, labels=labels, objects=objects)
    write_json(recording / FOLDER / "truth.json", document)
    return document
