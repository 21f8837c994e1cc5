"""What an ingest run is asked to do, how it tells how far it is, and what it came to."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeVar

from pydantic import ValidationError

from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.executors.choice import ExecutorChoice
from mirror.ingest.dead_letters import DeadLetter
from mirror.ingest.maps import MapOutcome
from mirror.ingest.traversal import WriteOptions, WriteReport
from mirror.ingest.trigger import Pass
from mirror.recordings.protocol import DriveInfo
from mirror.schema.documents import CleaningOptions, CleaningReport, TriggerOptions
from mirror.schema.problems import describe_expected

FATAL: Final = (UsageError, DatasetError)
"""Errors that are not one recording's fault, and would meet the next one too."""

Thresholds = TypeVar("Thresholds", TriggerOptions, CleaningOptions)


def validate_thresholds(kind: type[Thresholds], given: Mapping[str, object]) -> Thresholds:
    """Return thresholds with the given values, and defaults for all others.

    Raises:
        UsageError: one is out of its range; it is named.
    """
    try:
        return kind.model_validate(dict(given))
    except ValidationError as error:
        first = error.errors()[0]
        place = f"--{str(first['loc'][0] if first['loc'] else 'threshold').replace('_', '-')}"
        raise UsageError(
            f"{first.get('input')!r}", place=place, expected=describe_expected(first),
            remedy=f"give another number with {place}",
        ) from error  # fmt: skip


@dataclass(frozen=True)
class IngestOptions:
    """Options of an ingest run.

    Attributes:
        reader: name of the recording reader; None: each recording is recognised.
        reader_options: handed to the reader.
        trigger: thresholds given on this run, by name; the dataset's own, else the defaults, for the rest.
        cleaning: likewise.
        weather_plugin: asked for the weather of drives whose source does not state it.
        write: how traversals are written.
        workers: threads.
        dry_run: judge only, write nothing.
        verify: hash the source images of drives that look unchanged, and the dataset's tables of them.
        replace: drop a drive of the same id whose recording has changed, and another map of the same scene.
        fail_fast: stop at the first drive that cannot be ingested.
        wait: wait for another writer of the dataset.
        licence: licence of the data, for ``dataset.json`` of a new dataset.
        max_missing_images: share of a recording's images whose files may be missing.
        maps: recorded road maps of scenes: GeoParquet files, and folders of them.
        executor: where drives are made; None: in this process, on `workers` threads.
        timeout_s: longest time that a job of an executor may take for one recording.
        retry_failed: also ingest the recordings that earlier runs could not ingest.
    """

    reader: str | None = None
    reader_options: Mapping[str, str] = field(default_factory=dict)
    trigger: Mapping[str, object] = field(default_factory=dict)
    cleaning: Mapping[str, object] = field(default_factory=dict)
    weather_plugin: str | None = None
    write: WriteOptions = field(default_factory=WriteOptions)
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    dry_run: bool = False
    verify: bool = False
    replace: bool = False
    fail_fast: bool = False
    wait: bool = False
    licence: str | None = None
    max_missing_images: float = 0.0
    maps: tuple[Path, ...] = ()
    executor: ExecutorChoice | None = None
    timeout_s: float = 3600.0
    retry_failed: bool = False


@dataclass(frozen=True)
class DriveReport:
    """The result of one drive's ingest, of a size that does not depend on the drive's poses or images.

    Attributes:
        path: where the recording lies.
        info: who, where, when.
        cleaning: what cleaning did.
        passes: accepted and refused.
        uncalibrated: names of cameras that the recording declares to be without a calibration.
    """

    path: Path
    info: DriveInfo
    cleaning: CleaningReport
    passes: tuple[Pass, ...]
    uncalibrated: tuple[str, ...] = ()


@dataclass
class IngestReport:
    """The result of an ingest run.

    Attributes:
        drives: drives that were judged, by id.
        unchanged: ids of drives that were there already, unchanged.
        traversals: written or found complete.
        failures: recordings that could not be ingested, each with its error.
        dead_letters: the same, as rows that the dataset keeps for `mirror ingest --retry-failed`.
        images: images written.
        bytes: of those images.
        linked: those of them that are hard links.
        maps: what became of each given road map, by scene.
        licence: of the dataset, where this run wrote into it; None: it states none.
    """

    drives: dict[str, DriveReport] = field(default_factory=dict)
    unchanged: list[str] = field(default_factory=list)
    traversals: list[WriteReport] = field(default_factory=list)
    failures: list[tuple[Path, MirrorError]] = field(default_factory=list)
    dead_letters: list[DeadLetter] = field(default_factory=list)
    maps: dict[str, MapOutcome] = field(default_factory=dict)
    licence: str | None = None

    def fail(self, path: Path, error: MirrorError, status: str = "failed", attempts: int = 1) -> None:
        """Add a recording that could not be ingested.

        Args:
            path: the recording.
            error: its error.
            status: see `mirror.executors.job.Failure`.
            attempts: number of attempts at it.
        """
        self.failures.append((path, error))
        self.dead_letters.append(DeadLetter(str(path.absolute()), status, type(error).__name__, str(error), attempts))

    @property
    def common_licence(self) -> str | None:
        """The licence that all judged recordings state; None if they state several, or some state none."""
        licences = {drive.info.licence for drive in self.drives.values()}
        return licences.pop() if len(licences) == 1 else None

    @property
    def other_licences(self) -> list[str]:
        """Licences that recordings state and the dataset does not state, in order."""
        stated = {drive.info.licence for drive in self.drives.values() if drive.info.licence}
        return sorted(stated - {self.licence})

    @property
    def images(self) -> int:
        """Images written by this run."""
        return sum(one.images for one in self.traversals if not one.reused)

    @property
    def without_pose(self) -> int:
        """Images within the traversals that were left out because they were taken in a gap of the poses."""
        return sum(one.without_pose for one in self.traversals)

    @property
    def missing(self) -> int:
        """Number of images that the recordings lack within the traversals, judged by pauses of the cameras."""
        return sum(one.missing for one in self.traversals)

    @property
    def repeated(self) -> dict[str, int]:
        """By camera, number of images within the traversals that were left out because their stamp is repeated."""
        counts: Counter[str] = Counter()
        for one in self.traversals:
            counts.update(one.repeated)
        return dict(counts)

    @property
    def bytes(self) -> int:
        """Total size of the images that this run wrote."""
        return sum(one.bytes for one in self.traversals if not one.reused)

    @property
    def linked(self) -> int:
        """The number of hard links among the written images."""
        return sum(one.linked for one in self.traversals)
