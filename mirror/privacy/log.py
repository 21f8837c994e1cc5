"""The log of a redaction: one line an image, with what was found and what was done. It holds no pixels."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final, Literal

from pydantic import Field, ValidationError

from mirror.errors import SchemaError
from mirror.privacy.regions import Kind, Region
from mirror.schema.documents import Document
from mirror.schema.problems import describe_problem
from mirror.schema.strict_json import decode_json
from mirror.version import __version__

LOG: Final = "log.jsonl"


class DetectorRecord(Document):
    """A detector that searched an image.

    Attributes:
        kind: what it finds.
        name: its name.
        version: version of its code.
        weights_sha256: SHA-256 of its weights.
        threshold: smallest score of its regions.
    """

    kind: Kind
    name: str
    version: str
    weights_sha256: str
    threshold: float


class Review(Document):
    """A person's answer about an image.

    Attributes:
        verdict: `ok`: nothing is missed; `miss`: something is; `false`: a region shows neither face nor plate.
        reviewer: name or pseudonym of the person.
    """

    verdict: Literal["ok", "miss", "false"]
    reviewer: str


class ImageRecord(Document):
    """One line of the log.

    Attributes:
        traversal_id: the traversal.
        camera: the camera.
        timestamp_ns: mid-exposure of the image.
        out_sha256: SHA-256 of the redacted bytes, in hexadecimal.
        source_sha256: SHA-256 of the recorded bytes that were searched and redacted; None: an earlier version did not
            record it, or the line is one of a release, which must not identify originals.
        width_px: width of the raster.
        height_px: height of the raster.
        detectors: detectors that searched it.
        skipped: number of tiles that were not searched, by the reason.
        regions: what was removed, before it was enlarged.
        face_operator: operator of faces.
        plate_operator: operator of number plates.
        grow: share by which regions were enlarged.
        plate_region: region of the number plates, as the user stated it; None: an earlier version did not record it.
        review: what a person said of it; None: it was not reviewed.
        tool: version of this program.
    """

    traversal_id: str
    camera: str
    timestamp_ns: int
    out_sha256: str
    source_sha256: str | None = None
    width_px: int
    height_px: int
    detectors: tuple[DetectorRecord, ...]
    skipped: dict[str, int] = Field(default_factory=dict)
    regions: tuple[Region, ...] = ()
    face_operator: str
    plate_operator: str
    grow: float
    plate_region: str | None = None
    review: Review | None = None
    tool: str = __version__

    @property
    def key(self) -> tuple[str, str, int]:
        """Traversal, camera and timestamp."""
        return self.traversal_id, self.camera, self.timestamp_ns


def encode_log(records: Iterable[ImageRecord]) -> bytes:
    """Encode a log as the bytes of its file: one line for each image, in the order of the images."""
    lines = [record.model_dump_json() for record in sorted(records, key=lambda record: record.key)]
    return "".join(f"{line}\n" for line in lines).encode()


def read_log(path: Path) -> list[ImageRecord]:
    """Read a log.

    Raises:
        SchemaError: a line is broken; it is named.
    """
    return [_decode(line, path, number) for number, line in enumerate(path.read_bytes().splitlines(), 1)]


def read_plate_region(path: Path) -> str | None:
    """Read, from a log's first line, the region of number plates given to its run; None if it is not recorded.

    Raises:
        SchemaError: the line is broken.
    """
    with path.open("rb") as file:
        line = file.readline()
    return _decode(line, path, 1).plate_region if line else None


def _decode(line: bytes, path: Path, number: int) -> ImageRecord:
    try:
        return ImageRecord.model_validate(decode_json(line))
    except ValueError as error:
        problem = describe_problem(error.errors()[0]) if isinstance(error, ValidationError) else str(error)
        raise SchemaError(
            problem, file=path, place=f"line {number}", expected="one JSON object an image",
            remedy="restore the file, or write the redaction again",
        ) from error  # fmt: skip
