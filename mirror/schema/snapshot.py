"""The documents of the index: numbered snapshots, and the sources of each segment."""

from __future__ import annotations

import re
from typing import Annotated, Final

from pydantic import Field

from mirror.schema.documents import Document, Identifier
from mirror.schema.version import SCHEMA_VERSION

SNAPSHOTS: Final = "index/snapshots"
SOURCES: Final = "sources.json"
_NAME: Final = re.compile(r"([0-9]{8})\.json")

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class IndexSegment(Document):
    """A part of the index: immutable tables of some drives, in the folder ``index/<name>/``.

    Attributes:
        name: first 16 digits of the hash of its manifest.
        manifest: SHA-256 of its ``manifest.json``.
        sources: SHA-256 of its ``sources.json``.
        drives: the drives whose rows are read; rows of others were replaced by later segments.
        scenes: the scenes whose rows of the table of scenes are read.
        is_whole: False: it has rows that are not read.
    """

    name: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    manifest: Sha256
    sources: Sha256
    drives: tuple[Identifier, ...]
    scenes: tuple[Identifier, ...]
    is_whole: bool = True


class IndexSnapshot(Document):
    """``index/snapshots/<number>.json``: a state of the index, which never changes.

    Attributes:
        schema_version: version of the on-disk format.
        oldest: the oldest snapshot whose rows all have their files still.
        segments: what the index consists of.
    """

    schema_version: str = SCHEMA_VERSION
    oldest: int = Field(default=1, ge=1)
    segments: tuple[IndexSegment, ...] = ()

    @property
    def drives(self) -> dict[str, IndexSegment]:
        """The segment of each drive."""
        return {drive_id: segment for segment in self.segments for drive_id in segment.drives}

    @property
    def scenes(self) -> dict[str, IndexSegment]:
        """The segment of each scene's row."""
        return {scene_id: segment for segment in self.segments for scene_id in segment.scenes}


class DriveSource(Document):
    """Hashes of all that a drive's rows were derived from.

    Attributes:
        manifest: SHA-256 of the drive's manifest.
        source: fingerprint of its recording.
        configuration: hash of the options that decided what was written.
        scenes: the scenes that it was judged for.
        traversals: of each traversal, the hashes of its folders and of its rig, by name.
    """

    manifest: str
    source: str
    configuration: str
    scenes: tuple[str, ...]
    traversals: dict[str, dict[str, str]]


class SegmentSources(Document):
    """``index/<segment>/sources.json``: hashes of all that a segment was derived from.

    Attributes:
        schema_version: version of the on-disk format.
        derivation: number of the rule by which the index was derived.
        drives: by drive id.
        scenes: hashes of the regions of interest, by scene id.
        maps: hashes of the manifests of recorded road maps, by scene id.
    """

    schema_version: str = SCHEMA_VERSION
    derivation: int
    drives: dict[str, DriveSource] = Field(default_factory=dict)
    scenes: dict[str, str] = Field(default_factory=dict)
    maps: dict[str, str] = Field(default_factory=dict)


def snapshot_path(number: int) -> str:
    """Return the path of a snapshot, relative to the dataset's root."""
    return f"{SNAPSHOTS}/{number:08d}.json"


def snapshot_number(name: str) -> int | None:
    """Return the number of a snapshot by the name of its file; None: it is no snapshot."""
    found = _NAME.fullmatch(name)
    return None if found is None else int(found[1])
