"""The folder ``truth`` of a recording: what it says of itself, and what is read back from it."""

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
        track_id: as in ``boxes.parquet``.
        category: its class.
    """

    track_id: str
    category: str


class TruthDocument(Document):
    """``truth.json``.

    Attributes:
        scene: whose east-north-up frame at its centre is the world frame.
        kinds: of the images' truth that is there.
        labels: values of the semantic masks by name.
        objects: the k-th, counting from 1, has the value k in the instance masks.
    """

    format: Literal["mirror-truth"] = "mirror-truth"
    version: Literal["1.0"] = "1.0"
    scene: Roi
    kinds: tuple[Kind, ...]
    labels: dict[str, int]
    objects: tuple[TruthObject, ...]


@dataclass(frozen=True)
class Truth:
    """The truth of one recording.

    Args:
        recording: a recording's folder.

    Raises:
        DatasetError: there is no truth in it.
    """

    recording: Path

    @property
    def folder(self) -> Path:
        """Where it lies."""
        return self.recording / FOLDER

    @cached_property
    def document(self) -> TruthDocument:
        """What it says of itself."""
        return read_json(self.folder / "truth.json", TruthDocument)

    def poses(self) -> pa.Table:
        """Exact poses of the vehicle and of all images: `mirror.synth.truth.tables.POSES`."""
        return read_table(self.folder / "poses.parquet", POSES)

    def boxes(self) -> pa.Table:
        """Exact boxes with visibility, image by image: `mirror.synth.truth.tables.BOXES`."""
        return read_table(self.folder / "boxes.parquet", BOXES)

    def calibrations(self) -> list[Calibration]:
        """The cameras as they are."""
        return read_calibrations(self.folder / "calibrations.json")

    def read(self, kind: Kind, camera: str, timestamp_ns: int) -> AnyArray:
        """The truth of one image, by its recorded stamp; `mirror.synth.truth.images.KINDS` says what it is.

        Raises:
            RecordingError: there is none, or it is broken.
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
