"""The JSON documents of a dataset, as validated models."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from mirror.schema.version import SCHEMA_VERSION

_IDENTIFIER = r"^[A-Za-z0-9][A-Za-z0-9_\-]{0,119}$"
Identifier = Annotated[str, Field(pattern=_IDENTIFIER)]

CANONICAL_CAMERAS = ("front_wide", "front_narrow", "front_left", "front_right", "rear_left", "rear_right", "rear")


def is_identifier(text: str) -> bool:
    """Whether a text can be an id: letters, digits, ``_`` and ``-``, so that it can be a folder and part of an id."""
    return re.fullmatch(_IDENTIFIER, text) is not None


class Document(BaseModel):
    """Base of all documents: unknown keys are refused, values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Roi(Document):
    """A region of interest: a circle round a point on WGS 84, or in a local metric frame.

    Attributes:
        scene_id: the scene's id.
        longitude_deg: centre (geodetic ROI).
        latitude_deg: centre (geodetic ROI).
        frame: name of the local metric frame (local ROI).
        x_m: centre in that frame.
        y_m: centre in that frame.
        radius_m: radius on the ellipsoid surface, or in the plane of the local frame.
        height_m: height of the world's origin above the ellipsoid.
        city: city, if known.
        scene_type: urban, highway, rural or campus, if known.
    """

    scene_id: Identifier
    longitude_deg: float | None = Field(default=None, ge=-180, le=180)
    latitude_deg: float | None = Field(default=None, ge=-90, le=90)
    frame: str | None = None
    x_m: float | None = None
    y_m: float | None = None
    radius_m: float = Field(default=200.0, gt=0, le=20_000)
    height_m: float = 0.0
    city: str | None = None
    scene_type: Literal["urban", "highway", "rural", "campus"] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Roi:
        geodetic = self.longitude_deg is not None and self.latitude_deg is not None
        local = self.frame is not None and self.x_m is not None and self.y_m is not None
        if geodetic == local:
            raise ValueError("a ROI has either longitude_deg and latitude_deg, or frame, x_m and y_m")
        return self


class TriggerOptions(Document):
    """What makes a pass a traversal; the defaults are the paper's, the rest is the DESIGN's.

    Attributes:
        min_duration_s: accepted from this duration on.
        min_path_m: accepted from this driven length on.
        min_overlap: accepted above this share of path inside the ROI.
        join_gap_s: visits at most this far apart are joined.
        max_gap_s: a pose gap longer than this ends a visit.
        min_step_m: path counts only after moving this far from the last counted pose.
        step_sigmas: ... or this many sigmas of the fix, where the source states it and it is more. Six: of ten hours
            of white noise at 10 Hz two steps pass; at three, one in ten fixes would.
        trim_standstill_s: a standstill longer than this ends a visit and is left out; None: keep standstills.
    """

    min_duration_s: float = Field(default=10.0, ge=0)
    min_path_m: float = Field(default=20.0, ge=0)
    min_overlap: float = Field(default=0.9, ge=0, lt=1)
    join_gap_s: float = Field(default=3.0, ge=0)
    max_gap_s: float = Field(default=2.0, gt=0)
    min_step_m: float = Field(default=0.5, ge=0)
    step_sigmas: float = Field(default=6.0, ge=0)
    trim_standstill_s: float | None = Field(default=60.0, gt=0)


class CleaningOptions(Document):
    """How fixes are cleaned before the trigger sees them.

    Attributes:
        max_speed_mps: a fix that needs more from the last good one is an outlier.
        max_acceleration_mps2: a fix off the line between its neighbours by more than half of this times both time
            steps, plus ``noise_m``, is an outlier.
        noise_m: what noise alone may add to that deviation.
        backward_time: `sort` the stamps, or `refuse` the drive.
        max_bad_rows: the largest share of rows that may make no pose; a drive with more of them is refused.
    """

    max_speed_mps: float = Field(default=70.0, gt=0)
    max_acceleration_mps2: float = Field(default=12.0, gt=0)
    noise_m: float = Field(default=5.0, ge=0)
    backward_time: Literal["sort", "refuse"] = "sort"
    max_bad_rows: float = Field(default=0.01, ge=0, le=1)


class CleaningReport(Document):
    """What cleaning did to a drive's fixes.

    Attributes:
        poses: fixes read.
        kept: fixes left.
        bad_rows: number of rows that make no pose, by reason: `cells` (a line with too few or too many cells),
            `number` (a cell that is no number), `time` (no stamp), `rotation` (off unit length, or not finite), `sigma`
            (negative or infinite), `file` (in a part of the drive that is missing or damaged).
        invalid: without a position, or with one that is not finite or off the globe.
        missing: those of the invalid ones that have no position at all.
        backward_time: fixes that were earlier than one before them (sorted).
        duplicate_time: fixes with the stamp of the one before.
        repeated: fixes at the very place of the one before, collapsed to the first: the receiver was frozen.
        outliers: fixes that failed the speed or the acceleration test.
        restarts: how often a new track was taken up after a run of outliers that agreed with each other.
    """

    poses: int
    kept: int
    bad_rows: dict[str, int] = Field(default_factory=dict)
    invalid: int
    missing: int = 0
    backward_time: int
    duplicate_time: int
    repeated: int
    outliers: int
    restarts: int


class RigCamera(Document):
    """One camera of a rig.

    Attributes:
        name: the name used in every table.
        source_name: what the source calls it.
        static_mask: PNG beside the rig file, non-zero where the vehicle itself is seen; None: not known.
    """

    name: str
    source_name: str
    static_mask: str | None = None


class Rig(Document):
    """``rigs/<rig_id>.json``: the cameras of one kind of vehicle.

    Attributes:
        schema_version: of the on-disk format.
        rig_id: the rig's id.
        vehicle_type: make or class of the vehicle.
        reference_camera: its exposures define the frames.
        cameras: all cameras, in order.
    """

    schema_version: str = SCHEMA_VERSION
    rig_id: Identifier
    vehicle_type: str
    reference_camera: str
    cameras: tuple[RigCamera, ...]

    @model_validator(mode="after")
    def _consistent(self) -> Rig:
        names = [camera.name for camera in self.cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"camera names repeat: {names}")
        if self.reference_camera not in names:
            raise ValueError(f"reference camera {self.reference_camera!r} is not one of {names}")
        return self


class DatasetDocument(Document):
    """``dataset.json``: what the folder is.

    Attributes:
        schema_version: of the on-disk format.
        format: always ``mirror``.
        conventions: where the frames, units and names are specified.
        licence: licence of the data, if stated.
        trigger: the thresholds that every pass was judged by.
        cleaning: how every drive was cleaned.
    """

    schema_version: str = SCHEMA_VERSION
    format: Literal["mirror"] = "mirror"
    conventions: str = "docs/conventions.md"
    licence: str | None = None
    trigger: TriggerOptions
    cleaning: CleaningOptions


class Source(Document):
    """Where a drive came from.

    Attributes:
        reader: the recording reader that opened it.
        name: last component of the recording's path.
        files: number of files.
        bytes: their total size.
        fingerprint: SHA-256 over every file's relative path, size and modification time.
    """

    reader: str
    name: str
    files: int
    bytes: int
    fingerprint: str


class DriveDocument(Document):
    """``drives/<drive_id>/drive.json``: one recording of one vehicle.

    Attributes:
        schema_version: of the on-disk format.
        drive_id: the drive.
        vehicle_id: pseudonym of the vehicle.
        vehicle_type: make or class of the vehicle.
        rig_id: None for a poses-only drive.
        source: where it came from.
        configuration: SHA-256 of the options that decide what ingest writes.
        scenes: scenes that the drive was judged against.
        frame: name of the local metric frame; None: WGS 84.
        time_base: the source's time base, converted to Unix time by the reader.
        body_frame: the frame whose poses the source recorded.
        is_clip: True if the source arrives as clips: each is judged whole.
        city: city, if known.
        start_ns: first cleaned pose.
        end_ns: last cleaned pose.
        cleaning: what cleaning did.
        images_without_pose: images within accepted passes that were left out, as they were taken in a gap of the poses.
    """

    schema_version: str = SCHEMA_VERSION
    drive_id: Identifier
    vehicle_id: Identifier
    vehicle_type: str
    rig_id: Identifier | None
    source: Source
    configuration: str
    scenes: tuple[str, ...]
    frame: str | None
    time_base: str
    body_frame: str
    is_clip: bool
    city: str | None
    start_ns: int
    end_ns: int
    cleaning: CleaningReport
    images_without_pose: int = 0


class FileEntry(Document):
    """One file of a folder: its size and hash."""

    bytes: int
    sha256: str


class ImageTotals(Document):
    """Number and total size of the images of a folder; the images table has the size and hash of each."""

    count: int
    bytes: int


class Manifest(Document):
    """``manifest.json``, written last: a folder is complete if and only if it is there.

    Attributes:
        schema_version: of the on-disk format.
        derived_from: hashes of what the folder was made from, by name.
        files: every file except the images, relative to the folder.
        pictures: number and total size of the images; the images table in ``files`` has the size and hash of each.
    """

    schema_version: str = SCHEMA_VERSION
    derived_from: dict[str, str] = Field(default_factory=dict)
    files: dict[str, FileEntry] = Field(default_factory=dict)
    pictures: ImageTotals | None = None

    @property
    def content(self) -> str:
        """SHA-256 over ``files`` alone: the same for equal content, whatever it was made from."""
        plain = self.model_dump(mode="json", include={"files"})
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


Light = Literal["day", "dusk", "night", "unknown"]
Weather = Literal["clear", "clouds", "rain", "snow", "fog", "unknown"]
Role = Literal["train", "val", "test", "held_out", "unused"]


class NovelTraversal(Document):
    """Per scene, some traversals to train on and some to hold out; the default is the paper's 4 + 1.

    Attributes:
        method: tag.
        train: traversals a scene to train on.
        held_out: traversals a scene to hold out.
    """

    method: Literal["novel-traversal"] = "novel-traversal"
    train: int = Field(default=4, ge=1)
    held_out: int = Field(default=1, ge=1)


class ByScene(Document):
    """Whole scenes to each role, in these shares.

    Attributes:
        method: tag.
        train: share of the scenes.
        val: share of the scenes.
        test: share of the scenes.
    """

    method: Literal["by-scene"] = "by-scene"
    train: float = Field(default=0.7, ge=0, le=1)
    val: float = Field(default=0.15, ge=0, le=1)
    test: float = Field(default=0.15, ge=0, le=1)

    @model_validator(mode="after")
    def _whole(self) -> ByScene:
        if abs(self.train + self.val + self.test - 1.0) > 1e-9:
            raise ValueError(f"the shares {self.train} + {self.val} + {self.test} do not add up to 1")
        return self


class Condition(Document):
    """What a traversal was recorded in; all that is given must hold.

    Attributes:
        light: the light; None: any.
        weather: the weather; None: any.
    """

    light: Light | None = None
    weather: Weather | None = None

    @model_validator(mode="after")
    def _some(self) -> Condition:
        if self.light is None and self.weather is None:
            raise ValueError("a condition names a light, a weather or both")
        return self


class ByCondition(Document):
    """Traversals by what they were recorded in; what fits ``test`` is never trained on.

    Attributes:
        method: tag.
        train: a traversal that fits one of these and none of ``test`` is trained on.
        test: a traversal that fits one of these is tested on.
    """

    method: Literal["by-condition"] = "by-condition"
    train: tuple[Condition, ...] = Field(min_length=1)
    test: tuple[Condition, ...] = Field(min_length=1)


SplitMethod = Annotated[NovelTraversal | ByScene | ByCondition, Field(discriminator="method")]


class SplitDocument(Document):
    """``splits/<name>.json``: a frozen division of the dataset's traversals.

    Attributes:
        schema_version: of the on-disk format.
        name: the split.
        parameters: the method and what it was asked for.
        seed: what the choice was drawn by.
        scenes: the scenes it was restricted to; None: all.
        dataset_hash: SHA-256 over ``manifests``: what the split was made of.
        manifests: SHA-256 over the files that each traversal's recorded manifest lists, by traversal id. When a
            recording was copied or modified does not count, what it holds does.
        assignments: the role of each traversal, by id; ``unused``: known to the split, and in no role.
        left_out: why a scene or a traversal is in no role, by its id.
        added: traversals that were put in by an extension, after the split was frozen.
    """

    schema_version: str = SCHEMA_VERSION
    name: Identifier
    parameters: SplitMethod
    seed: int
    scenes: tuple[str, ...] | None
    dataset_hash: str
    manifests: dict[str, str]
    assignments: dict[str, Role]
    left_out: dict[str, str] = Field(default_factory=dict)
    added: tuple[str, ...] = ()
