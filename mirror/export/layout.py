"""What a format has to state: its files, its cameras, and what it keeps of a dataset."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mirror.export.lenses import LensMap
from mirror.export.lidars import SweepFiles
from mirror.export.scene import ExportImage, ExportScene
from mirror.progress import ProgressReporter


@dataclass(frozen=True)
class Kept:
    """A field that a format keeps.

    Attributes:
        field: the field of the dataset.
        place: where it stands in the format.
        tolerance: largest difference after a round trip, with its unit; ``exact``: none.
    """

    field: str
    place: str
    tolerance: str


@dataclass(frozen=True)
class Written:
    """The files of a format other than images and masks, with counts of their contents.

    Attributes:
        files: paths of the files.
        boxes: number of boxes in them.
        points: number of points in them.
        masks: number of masks in them.
        notes: decisions that the user should know.
    """

    files: tuple[Path, ...]
    boxes: int = 0
    points: int = 0
    masks: int = 0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ExportLayout:
    """One export format with its writer.

    Attributes:
        name: the word of the command line.
        title: the format in words, with its version.
        lens_of: its camera models.
        image_path: path of an image below the export's folder.
        mask_path: path of an image's mask below that folder; None: the format has no masks.
        needs_all_masks: whether every image must have a mask as soon as one has.
        write: writes all other files into a folder.
        require: refuses scenes that the format cannot hold, before anything is written; None: it holds every scene.
        holds_points: whether the format has points, from which trainers start.
        holds_images: whether `write` puts the images into files of its own; `image_path` then names them there.
        sweeps: the places of lidar sweeps; None: the format has none.
        kept: fields that it keeps.
        lost: fields that it cannot hold.
    """

    name: str
    title: str
    lens_of: LensMap
    image_path: Callable[[ExportImage], str]
    mask_path: Callable[[ExportImage], str] | None
    needs_all_masks: bool
    write: Callable[[ExportScene, Path, ProgressReporter], Written]
    kept: tuple[Kept, ...]
    lost: tuple[str, ...]
    require: Callable[[ExportScene], None] | None = None
    holds_points: bool = False
    holds_images: bool = False
    sweeps: Callable[[ExportScene], SweepFiles] | None = None
