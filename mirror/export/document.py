"""``export.json``: what an export contains, what it was made from, and what its format cannot hold."""

from __future__ import annotations

from typing import Final, Literal

from mirror.schema.documents import Document, FileEntry

MANIFEST: Final = "export.json"
"""Written last: an export without it is not complete."""

UNFINISHED: Final = ".exporting"
"""Holds the request of an export that is not complete."""


class ExportRequest(Document):
    """The request of an export; equal requests give equal exports.

    Attributes:
        layout: the format.
        index_sha256: hash of the dataset's index.
        scene: id of the scene.
        traversals: ids of the traversals.
        cameras: names of the cameras.
        split: split whose roles are written; None: no roles.
        poses: pose layer.
        calibrations: calibration layer.
        boxes: box layer; None: the only one.
        points: layer of points; None: the only one.
        undistort: whether images are resampled to pinhole cameras.
        copies: whether images are copied, and never linked.
    """

    layout: str
    index_sha256: str
    scene: str
    traversals: tuple[str, ...]
    cameras: tuple[str, ...]
    split: str | None
    poses: str
    calibrations: str
    boxes: str | None
    points: str | None
    undistort: bool
    copies: bool


class ExportDocument(Document):
    """The document of a complete export.

    Attributes:
        format: always ``mirror-export``.
        version: version of this document's format.
        request: what the export was made from.
        origin_m: the scene's world frame minus the export's world frame.
        images: number of images.
        masks: number of masks.
        points: number of points.
        boxes: number of boxes.
        withheld: images that the published dataset withholds, or that a redaction left out, and that are left out.
        sources_sha256: hash of the encoded images that it was made from.
        without_frame: images that belong to no frame, and are left out.
        lost: what the format cannot hold.
        notes: what this export decided.
        files: size and SHA-256 of all files except images and masks, by path.
    """

    format: Literal["mirror-export"] = "mirror-export"
    version: Literal["1"] = "1"
    request: ExportRequest
    origin_m: tuple[float, float, float]
    images: int
    masks: int
    points: int
    boxes: int
    withheld: int
    sources_sha256: str | None = None
    without_frame: int
    lost: tuple[str, ...]
    notes: tuple[str, ...]
    files: dict[str, FileEntry]
