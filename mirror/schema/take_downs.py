"""``take_downs.json``: the images of a dataset that were taken down."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from mirror.schema.documents import Document
from mirror.schema.snapshot import Sha256
from mirror.schema.version import SCHEMA_VERSION

TAKE_DOWNS: Final = "take_downs.json"


class TakenDownImage(Document):
    """An image that was taken down.

    Attributes:
        traversal_id: the traversal.
        camera: the camera.
        timestamp_ns: mid-exposure.
        reason: why; empty: not stated.
        sha256: SHA-256 of the bytes that showed it, recorded and redacted; empty in a published dataset.
        snapshot: the first snapshot of the index without it; null: the take-down was interrupted.
    """

    traversal_id: str
    camera: str
    timestamp_ns: int
    reason: str = ""
    sha256: tuple[Sha256, ...] = ()
    snapshot: int | None = Field(default=None, ge=1)

    @property
    def key(self) -> tuple[str, str, int]:
        """Traversal, camera and timestamp."""
        return self.traversal_id, self.camera, self.timestamp_ns

    @property
    def drive_id(self) -> str:
        """The drive, which the id of a traversal names."""
        return self.traversal_id.split(".")[1]


class TakeDowns(Document):
    """``take_downs.json``; a dataset without the file has lost no image.

    Attributes:
        schema_version: version of the on-disk format.
        images: in the order of traversal, camera and timestamp. No row of the index shows them.
    """

    schema_version: str = SCHEMA_VERSION
    images: tuple[TakenDownImage, ...] = ()
