"""Reads ``recording.json`` and the calibrations of the `folder` layout; docs/recordings/folder.md specifies them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from mirror.errors import RecordingError, SchemaError
from mirror.recordings.calibration import SE3, Calibration
from mirror.recordings.opening import read_json
from mirror.recordings.time import TIME_BASES
from mirror.schema.documents import Document, Identifier
from mirror.schema.problems import describe_problems

DOCUMENT_NAME: Final = "recording.json"


class PositionFrame(Document):
    """The frame of the positions.

    Attributes:
        kind: WGS 84 degrees, UTM, earth-centred earth-fixed (ECEF), or a local metric frame.
        zone: the UTM zone.
        hemisphere: the hemisphere of the UTM zone.
        name: name of a local frame; recordings with the same name share the frame.
    """

    kind: Literal["wgs84", "utm", "ecef", "local"]
    zone: Annotated[int, Field(ge=1, le=60)] | None = None
    hemisphere: Literal["north", "south"] | None = None
    name: Identifier | None = None

    @model_validator(mode="after")
    def _complete(self) -> PositionFrame:
        utm = self.zone is not None and self.hemisphere is not None
        if (self.kind == "utm") != utm or (self.kind == "local") != (self.name is not None):
            raise ValueError("utm needs zone and hemisphere, local needs name, the other kinds take none of them")
        return self


class FolderCamera(Document):
    """One camera of a recording in the folder layout.

    Attributes:
        source_name: the source's name of the camera; None: the same name.
        static_mask: PNG inside the recording, non-zero where the image shows the vehicle itself.
        video_start_ns: Unix time of the first frame of a video without a table of exposures.
        calibrated: False: there is no calibration of the camera, and `mirror check` asks for none.
    """

    source_name: str | None = None
    static_mask: str | None = None
    video_start_ns: int | None = None
    calibrated: bool = True


class FolderDocument(Document):
    """``recording.json``; the attributes are those of `mirror.recordings.protocol.DriveInfo` and `RigInfo`."""

    format: Literal["mirror-folder"]
    version: Annotated[str, Field(pattern=r"^1\.\d+$")]
    drive_id: Identifier
    vehicle_id: Identifier
    vehicle_type: str
    rig_id: Identifier | None = None
    time_base: str
    frame: PositionFrame
    body_frame: str = "ego"
    ego_SE3_body: SE3 | None = None
    is_clip: bool = False
    city: str | None = None
    weather: Literal["clear", "clouds", "rain", "snow", "fog"] | None = None
    light: Literal["day", "dusk", "night"] | None = None
    licence: str | None = None
    reference_camera: str | None = None
    cameras: dict[Identifier, FolderCamera] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> FolderDocument:
        if self.time_base not in TIME_BASES:
            raise ValueError(f"time_base is none of {', '.join(TIME_BASES)}")
        if self.cameras and (self.rig_id is None or self.reference_camera not in self.cameras):
            raise ValueError("a recording with cameras needs a rig_id, and a reference_camera among its cameras")
        return self


def read_document(file: Path) -> FolderDocument:
    """Read ``recording.json``.

    Raises:
        RecordingError: it is missing or broken, or keys are not as specified; all of them are named.
    """
    with _document_errors(file):
        return FolderDocument.model_validate(read_json(file))


def read_calibrations(file: Path) -> list[Calibration]:
    """Read one stage's calibrations.

    Raises:
        RecordingError: the file is broken, or entries are not as specified; all of them are named.
    """
    with _document_errors(file):
        return TypeAdapter(list[Calibration]).validate_python(read_json(file))


@contextmanager
def recording_errors() -> Iterator[None]:
    """Turn a `SchemaError` of a recording's table into a `RecordingError`."""
    try:
        yield
    except SchemaError as error:
        raise RecordingError(
            error.problem, file=error.file, place=error.place, expected=error.expected, remedy=error.remedy
        ) from error


@contextmanager
def _document_errors(file: Path) -> Iterator[None]:
    """Turn a validation error into a `RecordingError` that names every wrong key."""
    try:
        yield
    except ValidationError as error:
        problem, place = describe_problems(error.errors())
        raise RecordingError(
            problem,
            file=file,
            place=place,
            expected="what docs/recordings/folder.md specifies for this key",
            remedy="correct what is named",
        ) from error
