"""The JSON documents of a dataset, as validated models."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Annotated, ClassVar, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from mirror.schema.hashing import hash_document
from mirror.schema.links import is_file_name
from mirror.schema.version import DATASET_VERSION, SCHEMA_VERSION

IDENTIFIER = r"^[A-Za-z0-9][A-Za-z0-9_\-]{0,119}$"
Identifier = Annotated[str, Field(pattern=IDENTIFIER)]

CANONICAL_CAMERAS = ("front_wide", "front_narrow", "front_left", "front_right", "rear_left", "rear_right", "rear")


def is_identifier(text: str) -> bool:
    """Return whether a text is a valid id: letters, digits, ``_`` and ``-``, so that it can name a folder."""
    return re.fullmatch(IDENTIFIER, text) is not None


def require_inner_path(name: str) -> str:
    """Require that a path leads to a file below its folder; a validator of documents.

    Raises:
        ValueError: it is absolute, goes up, is not in its shortest form, or no file system has such a name.
    """
    if not is_file_name(name):
        raise ValueError(f"the path {name[:40]!r}... is no name of a file")
    path = PurePosixPath(name)
    if not path.parts or path.is_absolute() or ".." in path.parts or "\\" in name or str(path) != name:
        raise ValueError(f"the path {name!r} leads out of its folder")
    return name


InnerPath = Annotated[str, AfterValidator(require_inner_path)]
"""A path relative to a folder, of a file below it."""


class Document(BaseModel):
    """Base of all documents: unknown keys are refused, values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Roi(Document):
    """A region of interest: a circle around a point on WGS 84 or in a local metric frame.

    Attributes:
        scene_id: the scene's id.
        longitude_deg: longitude of the centre (geodetic ROI).
        latitude_deg: latitude of the centre (geodetic ROI).
        frame: name of the local metric frame (local ROI).
        x_m: x of the centre in that frame.
        y_m: y of the centre in that frame.
        radius_m: radius on the surface of the ellipsoid, or in the plane of the local frame.
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


_LONGEST_S: Final = 1e9
"""Thirty-one years: no drive is longer, and nanoseconds of it fit into 64 bits."""


class TriggerOptions(Document):
    """Thresholds that a pass must meet to become a traversal; the paper gives the defaults of the first three.

    Attributes:
        min_duration_s: shortest accepted duration.
        min_path_m: shortest accepted driven length.
        min_overlap: the share of the path inside the ROI must be greater than this.
        join_gap_s: visits are joined if the time between them is at most this.
        max_gap_s: a longer gap between poses ends a visit.
        min_step_m: path counts only after the vehicle has moved this far from the last counted pose.
        step_sigmas: as min_step_m, in sigmas of the fix; the larger of the two distances applies where the source
            states sigma. At six, ten hours of white noise at 10 Hz give two steps; at three, one fix in ten gives one.
        trim_standstill_s: a longer standstill ends a visit and is left out; None: standstills are kept.
    """

    min_duration_s: float = Field(default=10.0, ge=0, le=_LONGEST_S)
    min_path_m: float = Field(default=20.0, ge=0)
    min_overlap: float = Field(default=0.9, ge=0, lt=1)
    join_gap_s: float = Field(default=3.0, ge=0, le=_LONGEST_S)
    max_gap_s: float = Field(default=2.0, gt=0, le=_LONGEST_S)
    min_step_m: float = Field(default=0.5, ge=0)
    step_sigmas: float = Field(default=6.0, ge=0)
    trim_standstill_s: float | None = Field(default=60.0, gt=0, le=_LONGEST_S)


class CleaningOptions(Document):
    """Thresholds that clean fixes before the trigger.

    Attributes:
        max_speed_mps: a fix that requires a higher speed from the last good fix is an outlier.
        max_acceleration_mps2: a fix is an outlier if its distance from the line between its neighbours exceeds half of
            this acceleration times both time steps, plus ``noise_m``.
        noise_m: the part of that distance that noise may cause.
        backward_time: `sort` the stamps, or `refuse` the drive.
        max_bad_rows: the largest accepted share of rows that make no pose; a drive with a larger share is refused.
    """

    max_speed_mps: float = Field(default=70.0, gt=0)
    max_acceleration_mps2: float = Field(default=12.0, gt=0)
    noise_m: float = Field(default=5.0, ge=0)
    backward_time: Literal["sort", "refuse"] = "sort"
    max_bad_rows: float = Field(default=0.01, ge=0, le=1)


class CleaningReport(Document):
    """Counts of the fixes of a drive that cleaning dropped or moved.

    Attributes:
        poses: number of fixes read.
        kept: number of fixes after cleaning.
        bad_rows: number of rows that make no pose, by reason: `cells` (a line with too few or too many cells),
            `number` (a cell that is no number), `time` (no stamp), `rotation` (off unit length, or not finite), `sigma`
            (negative or infinite), `file` (in a part of the drive that is missing or damaged).
        invalid: number of fixes without a position, or with a position that is not finite or not on the globe.
        missing: number of the invalid fixes that have no position at all.
        backward_time: number of fixes earlier than a previous one; they were sorted.
        duplicate_time: number of fixes with the stamp of the previous one.
        repeated: number of fixes at exactly the position of the previous one; only the first is kept, because the
            receiver was frozen.
        outliers: number of fixes that failed the speed test or the acceleration test.
        restarts: number of times that a run of consistent outliers was taken as a new track.
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
        name: the name in every table.
        source_name: the source's name.
        static_mask: PNG in the folder of the rig file, non-zero where the image shows the vehicle itself; None: not
            known.
    """

    name: str
    source_name: str
    static_mask: InnerPath | None = None


class Rig(Document):
    """``rigs/<rig_id>.json``: the cameras of one type of vehicle.

    Attributes:
        schema_version: version of the on-disk format.
        rig_id: the rig's id.
        vehicle_type: make or class of the vehicle.
        reference_camera: the camera with the exposures that define the frames.
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
    """``dataset.json``: identifies the folder as a dataset.

    Attributes:
        schema_version: version of the on-disk format.
        format: always ``mirror``.
        conventions: the document that specifies frames, units and names.
        licence: licence of the data, if stated.
        trigger: the thresholds for every pass.
        cleaning: the cleaning of every drive.
    """

    needs_migration: ClassVar[bool] = True
    """Earlier versions are refused with the verb that migrates them (`mirror.schema.version.require_migrated`)."""

    schema_version: str = DATASET_VERSION
    format: Literal["mirror"] = "mirror"
    conventions: str = "docs/conventions.md"
    licence: str | None = None
    trigger: TriggerOptions
    cleaning: CleaningOptions


class RecordingSource(Document):
    """The recording of a drive.

    Attributes:
        reader: the reader that opened it.
        name: last component of the recording's path.
        files: number of files.
        bytes: total size of the files.
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
        schema_version: version of the on-disk format.
        drive_id: the drive.
        vehicle_id: pseudonym of the vehicle.
        vehicle_type: make or class of the vehicle.
        rig_id: the rig; None for a poses-only drive.
        source: the recording.
        configuration: SHA-256 of the options that decide what ingest writes.
        scenes: scenes that the drive was compared with.
        frame: name of the local metric frame; None: WGS 84.
        time_base: the source's time base; the reader converted it to Unix time.
        body_frame: the body of the recorded poses.
        is_clip: True if the source arrives as clips, each judged as a whole.
        city: city, if known.
        start_ns: time of the first cleaned pose.
        end_ns: time of the last cleaned pose.
        cleaning: the result of cleaning.
        images_without_pose: number of images within accepted passes that were left out because they were taken in a gap
            of the poses.
        images_repeated: number of images within accepted passes that were left out because another image of their
            camera has the same stamp.
        has_date: False: the recording declares that its stamps count from an arbitrary date.
        has_motion: False: the recording declares that its stamps only number the poses, as those of unordered photos.
        uncalibrated_cameras: cameras that the recording declares to be without a calibration.
    """

    schema_version: str = SCHEMA_VERSION
    drive_id: Identifier
    vehicle_id: Identifier
    vehicle_type: str
    rig_id: Identifier | None
    source: RecordingSource
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
    images_repeated: int = 0
    has_date: bool = True
    has_motion: bool = True
    uncalibrated_cameras: tuple[str, ...] = ()


class FileEntry(Document):
    """One file of a folder.

    Attributes:
        bytes: size of the file.
        sha256: SHA-256 of the file in hexadecimal.
    """

    bytes: int
    sha256: str


class ImageTotals(Document):
    """Number and total size of the images of a folder; the images table has the size and hash of each."""

    count: int
    bytes: int


class Manifest(Document):
    """``manifest.json``, written last: a folder is complete if and only if this file exists.

    Attributes:
        schema_version: version of the on-disk format.
        derived_from: hashes of the inputs of the folder, by name.
        files: every file except the images, relative to the folder.
        pictures: number and total size of the images; the images table in ``files`` has the size and hash of each.
    """

    schema_version: str = SCHEMA_VERSION
    derived_from: dict[str, str] = Field(default_factory=dict)
    files: dict[InnerPath, FileEntry] = Field(default_factory=dict)
    pictures: ImageTotals | None = None

    @property
    def content(self) -> str:
        """SHA-256 over ``files`` alone: equal content has the same hash, whatever its inputs are."""
        plain = self.model_dump(mode="json", include={"files"})
        return hash_document(plain)


Light = Literal["day", "dusk", "night", "unknown"]
Weather = Literal["clear", "clouds", "rain", "snow", "fog", "unknown"]
Role = Literal["train", "val", "test", "held_out", "unused"]


class NovelTraversal(Document):
    """Trains on some traversals of each scene and holds out others; the default is the paper's 4 + 1.

    Attributes:
        method: name of the method.
        train: number of traversals per scene to train on.
        held_out: number of traversals per scene to hold out.
    """

    method: Literal["novel-traversal"] = "novel-traversal"
    train: int = Field(default=4, ge=1)
    held_out: int = Field(default=1, ge=1)


class ByScene(Document):
    """Assigns whole scenes to roles by shares.

    Attributes:
        method: name of the method.
        train: share of the scenes for training.
        val: share of the scenes for validation.
        test: share of the scenes for testing.
    """

    method: Literal["by-scene"] = "by-scene"
    train: float = Field(default=0.7, ge=0, le=1)
    val: float = Field(default=0.15, ge=0, le=1)
    test: float = Field(default=0.15, ge=0, le=1)

    @model_validator(mode="after")
    def _whole(self) -> ByScene:
        total = self.train + self.val + self.test
        if not abs(total - 1.0) <= 1e-9:
            raise ValueError(f"the shares {self.train} + {self.val} + {self.test} add up to {total:g}; expected 1")
        return self


class LightAndWeather(Document):
    """Light and weather of a traversal; a traversal must match both that are given.

    Attributes:
        light: the light; None: any.
        weather: the weather; None: any.
    """

    light: Light | None = None
    weather: Weather | None = None

    @model_validator(mode="after")
    def _some(self) -> LightAndWeather:
        if self.light is None and self.weather is None:
            raise ValueError("a condition names a light, a weather or both")
        return self


class ByCondition(Document):
    """Assigns traversals to roles by light and weather; traversals that match ``test`` are never trained on.

    Attributes:
        method: name of the method.
        train: traversals that match one of these and none of ``test`` are trained on.
        test: traversals that match one of these are tested on.
    """

    method: Literal["by-condition"] = "by-condition"
    train: tuple[LightAndWeather, ...] = Field(min_length=1)
    test: tuple[LightAndWeather, ...] = Field(min_length=1)


class ByList(Document):
    """Assigns the traversals that are listed, as a published split names them.

    Attributes:
        method: name of the method.
        held_out: ids of the traversals to hold out.
        train: ids of the traversals to train on; None: all others of their scenes.
    """

    method: Literal["by-list"] = "by-list"
    held_out: tuple[str, ...] = Field(min_length=1)
    train: tuple[str, ...] | None = None


SplitMethod = Annotated[NovelTraversal | ByScene | ByCondition | ByList, Field(discriminator="method")]


class SplitDocument(Document):
    """``splits/<name>.json``: a frozen division of the dataset's traversals.

    Attributes:
        schema_version: version of the on-disk format.
        name: the split.
        parameters: the method and its parameters.
        seed: the seed of the random choice.
        scenes: the scenes of the split; None: all.
        dataset_hash: SHA-256 over ``manifests``: identifies the data of the split.
        manifests: SHA-256 over the files in each traversal's recorded manifest, by traversal id. It depends on the
            content of the recording, and not on the time at which it was copied or modified.
        assignments: the role of each traversal, by id; ``unused``: the traversal has no role.
        left_out: the reason why a scene or a traversal has no role, by its id.
        added: traversals that were added by an extension after the split was frozen.
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
