"""``mirror ingest RECORDING... --rois FILE --out DATASET``."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.counting import count_of
from mirror.errors import ExitCode, MirrorError, UsageError
from mirror.executors.arguments import ExecutorArguments

if TYPE_CHECKING:
    from mirror.ingest.request import IngestReport


@dataclass(frozen=True)
class TriggerArguments:
    """Thresholds at which a pass becomes a traversal. Defaults: the dataset's, or the paper's."""

    min_duration_s: Annotated[float | None, help_text(default="10")] = None
    """Shortest duration of a traversal."""
    min_path_m: Annotated[float | None, help_text(default="20")] = None
    """Shortest driven length of a traversal."""
    min_overlap: Annotated[float | None, help_text(default="0.9")] = None
    """A traversal has more than this share of its path inside the region."""
    join_gap_s: Annotated[float | None, help_text(default="3")] = None
    """Visits at most this far apart are joined."""
    max_gap_s: Annotated[float | None, help_text(default="2")] = None
    """A longer gap between poses ends a visit."""
    min_step_m: Annotated[float | None, help_text(default="0.5")] = None
    """Shorter steps do not count as path: a parked car's noise is not a drive."""
    step_sigmas: Annotated[float | None, help_text(default="6")] = None
    """Steps shorter than this many sigmas of the fix do not count as path either."""
    trim_standstill_s: Annotated[float | None, help_text(default="60")] = None
    """Longer standstills are left out; 0 keeps them."""


@dataclass(frozen=True)
class Cleaning:
    """Thresholds that clean position fixes before the trigger. Defaults: the dataset's, or these."""

    max_speed_mps: Annotated[float | None, help_text(default="70")] = None
    """A fix that needs a higher speed is an outlier."""
    max_acceleration_mps2: Annotated[float | None, help_text(default="12")] = None
    """A fix that needs a higher acceleration is an outlier."""
    noise_m: Annotated[float | None, help_text(default="5")] = None
    """Deviation that the acceleration test allows for noise."""
    backward_time: Annotated[Literal["sort", "refuse"] | None, help_text(default="sort")] = None
    """Whether to sort fixes with decreasing time, or to refuse the drive."""
    max_bad_rows: Annotated[float | None, help_text(default="0.01")] = None
    """A drive is refused if a larger share of its rows has no valid pose."""


_EXAMPLES = (
    "mirror ingest demo/recordings/*-* --rois demo/recordings/rois.geojson --out dataset",
    "mirror ingest demo/recordings --roi 11.5763,48.1371,200,centre --min-duration-s 5 --dry-run",
)
RENAMED_THRESHOLDS = {"--max-gap": "--max-gap-s"}
"""Old names of the options of `TriggerArguments` and `Cleaning`."""


@dataclass(frozen=True)
class Arguments:
    """Cut recordings into traversals: every pass through a region of interest that meets the trigger's thresholds.

    After an interruption the same command continues. With more recordings it appends, and without changes it writes
    nothing. Exit codes: 0 done, 2 could not run, 3 some recordings failed and the rest is complete.
    """

    recordings: Annotated[tyro.conf.Positional[tuple[Path, ...]], help_text(default="none", metavar="RECORDING...")]
    """One path per drive, a folder or file that a reader recognises; or a folder of recordings."""
    out: Annotated[str | None, help_text(default="none", metavar="DATASET")] = None
    """Folder of the dataset, new or existing, or s3://BUCKET/PATH. Required unless --dry-run is given."""
    rois: Annotated[Path | None, help_text(default="none; the dataset keeps its own", metavar="FILE")] = None
    """GeoJSON or CSV file of regions of interest."""
    roi: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="LON,LAT[,RADIUS_M[,ID]]")] = ()
    """A region of interest."""
    map: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction, help_text(metavar="FILE|FOLDER")] = ()
    """Recorded road map of a scene as GeoParquet, or a folder of maps. A dataset takes it without recordings too."""
    reader: Annotated[str | None, help_text(default="recognised from the files", metavar="NAME|FILE.py:CLASS")] = None
    """Reader of the recordings."""
    tz: Annotated[str | None, help_text(default="none", metavar="ZONE")] = None
    """Time zone of time stamps without one, such as Africa/Casablanca (csv reader)."""
    columns: Annotated[str | None, help_text(default="recognised from the header")] = None
    """Names of columns, such as time=Date+Time,lon=LON,lat=LAT (csv reader)."""
    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="KEY=VALUE")] = ()
    """Another option of the reader."""
    weather_from: Annotated[str | None, help_text(default="none", metavar="PLUGIN")] = None
    """Plug-in that estimates the weather from images, for recordings that do not state it."""
    trigger: tyro.conf.OmitArgPrefixes[TriggerArguments] = field(default_factory=TriggerArguments)
    cleaning: tyro.conf.OmitArgPrefixes[Cleaning] = field(default_factory=Cleaning)
    copy: bool = False
    """Copy images. Without it they are hard links where the file system allows that."""
    hash: bool = True
    """Read and hash every image, and refuse truncated and broken ones. --no-hash reads their headers only."""
    verify_images: bool = False
    """Decode every image, and refuse those that cannot be decoded."""
    max_missing_images: float = 0.0
    """Share of a recording's images whose files may be missing, 0 to 1; the drive is ingested without them."""
    images: Literal["jpeg", "video", "shards"] = "jpeg"
    """Form of the stored images. jpeg: a file each, also frames of recorded videos. video: those as the recording's own
    compressed video. shards: side by side in tar archives of 64 MiB, frame by frame."""
    references: Literal["size", "etag", "sha256"] = "size"
    """What the dataset keeps of images that a recording refers to by uri. size: their sizes, as the recording states
    them. etag: also the tags of their store, by a request an image. sha256: hashes of their bytes, which
    are transferred once."""
    workers: Annotated[int | None, help_text(default="one a core, or as many as a cluster has room for")] = None
    """Number of threads, or of workers of an executor."""
    executor: tyro.conf.OmitArgPrefixes[ExecutorArguments] = field(default_factory=ExecutorArguments)
    timeout_s: float = 3600.0
    """Longest time that a worker of --executor processes or ray may take for one recording; it is tried three times."""
    retry_failed: bool = False
    """Also ingest the recordings that earlier runs could not ingest; the dataset keeps a list of them in failures/."""
    dry_run: bool = False
    """Evaluate the passes and print them. Nothing is written."""
    verify: bool = False
    """Also hash the images of recordings with unchanged sizes and times, and the dataset's tables of unchanged drives:
    what is damaged is made again."""
    replace: bool = False
    """Ingest a drive again if its recording has changed, and replace another map of a scene."""
    fail_fast: bool = False
    """Stop at the first recording that cannot be ingested."""
    wait: bool = False
    """Wait until no other run writes the dataset. Without it, a dataset that is being written is an error."""
    licence: Annotated[str | None, help_text(default="none")] = None
    """Licence of the data, written into a new dataset."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror ingest", examples=_EXAMPLES, renamed=RENAMED_THRESHOLDS)
    is_dataset = arguments.out is not None and (Path(arguments.out) / "dataset.json").is_file()
    if not arguments.recordings and not (is_dataset and (arguments.map or arguments.retry_failed)):
        raise UsageError("no recording given", expected="mirror ingest RECORDING... --rois FILE --out DATASET")
    if not 0.0 <= arguments.max_missing_images <= 1.0:
        raise UsageError(f"{arguments.max_missing_images}", place="--max-missing-images", expected="0 to 1")
    if arguments.out is None and not arguments.dry_run:
        raise UsageError("no dataset folder given", place="--out", expected="--out DATASET, or --dry-run")

    from mirror.dataset.dataset import open as open_dataset
    from mirror.dataset.missing import find_missing
    from mirror.ingest.request import IngestOptions
    from mirror.ingest.rois import parse_roi, read_rois
    from mirror.ingest.run import ingest_recordings
    from mirror.ingest.traversal import WriteOptions
    from mirror.progress import progress_bar
    from mirror.recordings.discovery import find_recordings
    from mirror.remedies import complete_remedy

    choice = arguments.executor.choose("serial", arguments.workers)
    if arguments.timeout_s <= 0.0:
        raise UsageError(f"{arguments.timeout_s:g}", place="--timeout-s", expected="more than 0")
    search = find_recordings(arguments.recordings, arguments.reader)
    rois = read_rois(arguments.rois) if arguments.rois else []
    rois += [parse_roi(text) for text in arguments.roi]
    options = IngestOptions(
        reader=arguments.reader,
        reader_options=reader_options(arguments.option, tz=arguments.tz, columns=arguments.columns),
        trigger=stated_thresholds(arguments.trigger),
        cleaning=stated_thresholds(arguments.cleaning),
        weather_plugin=arguments.weather_from,
        write=WriteOptions(
            transfer="copy" if arguments.copy else "link",
            hashing=arguments.hash,
            decoding=arguments.verify_images,
            videos="video" if arguments.images == "video" else "jpeg",
            shards=arguments.images == "shards",
            references=arguments.references,
        ),
        workers=arguments.workers or os.cpu_count() or 1,
        executor=None if choice.kind == "serial" else choice,
        timeout_s=arguments.timeout_s,
        retry_failed=arguments.retry_failed,
        dry_run=arguments.dry_run,
        verify=arguments.verify,
        replace=arguments.replace,
        fail_fast=arguments.fail_fast,
        wait=arguments.wait,
        licence=arguments.licence,
        max_missing_images=arguments.max_missing_images,
        maps=arguments.map,
    )
    out = arguments.out or "dry-run"
    with progress_bar(quiet=arguments.json) as bar:
        report = ingest_recordings(search.recordings, rois, out, options, bar)
    for _, error in report.failures:
        complete_remedy(error, "mirror ingest", argv)
    missing = [] if arguments.dry_run or not report.traversals else find_missing(open_dataset(out))
    if arguments.json:
        passed_over = [str(path) for path in search.passed_over]
        plain = {**_plain(report, out), "passed_over": passed_over, "missing": [asdict(one) for one in missing]}
        print(json.dumps(plain))
    else:
        _print(report, out, dry_run=arguments.dry_run)
        for one in missing:
            print(one)
        print_failures(report.failures, search.passed_over)
    if not report.failures:
        return ExitCode.DONE
    if not arguments.json and not arguments.dry_run and (report.drives or report.unchanged):
        print(f"{len(report.failures)} recordings failed: correct them and run it again with --retry-failed")
    is_partly_done = report.drives or report.unchanged or (arguments.retry_failed and is_dataset)
    return ExitCode.PARTLY_DONE if is_partly_done else ExitCode.COULD_NOT_RUN


def stated_thresholds(thresholds: TriggerArguments | Cleaning) -> dict[str, object]:
    """Return the thresholds given on the command line, by name."""
    values: dict[str, object] = {name: value for name, value in vars(thresholds).items() if value is not None}
    if values.get("trim_standstill_s") == 0:
        values["trim_standstill_s"] = None
    return values


def reader_options(pairs: Sequence[str], **named: str | None) -> dict[str, str]:
    """Return the options for a reader.

    Args:
        pairs: ``key=value`` words.
        named: options with a flag of their own; None: not given.

    Raises:
        UsageError: a word has another form.
    """
    options = {key: value for key, value in named.items() if value is not None}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise UsageError(
                f"{pair!r} is not KEY=VALUE", place="--option",
                expected="the name of an option of the reader, =, and its value",
                remedy="give it as `--option KEY=VALUE`; docs/recordings/READER.md lists those of a reader",
            )  # fmt: skip
        options[key] = value
    return options


def _plain(report: IngestReport, out: str) -> dict[str, object]:
    return {
        "dataset": str(out),
        "drives": {
            drive_id: {
                "cleaning": drive.cleaning.model_dump(),
                "notes": list(drive.info.notes),
                "accepted": sum(row.accepted for row in drive.passes),
                "refused": dict(Counter(row.rule for row in drive.passes if row.rule)),
                "passes": [vars(row) for row in drive.passes],
            }
            for drive_id, drive in sorted(report.drives.items())
        },
        "unchanged": report.unchanged,
        "traversals": [vars(traversal) for traversal in report.traversals],
        "licence": report.licence,
        "other_licences": report.other_licences,
        "images": report.images,
        "bytes": report.bytes,
        "linked": report.linked,
        "images_without_pose": report.without_pose,
        "images_missing": report.missing,
        "images_repeated": report.repeated,
        "maps": report.maps,
        "failures": [{"recording": str(path), **error.to_dict()} for path, error in report.failures],
    }


def print_failures(failures: Sequence[tuple[Path, MirrorError]], passed_over: Sequence[Path]) -> None:
    """Print the recordings that were not read, with the reasons, on standard error."""
    for path in passed_over:
        print(f"skipped {path}: no reader recognises it", file=sys.stderr)
    for path, error in failures:
        # The message of an error may already begin with the path.
        named = error.file is not None and error.file.startswith(str(path))
        print(f"failed {error}" if named else f"failed {path}: {error}", file=sys.stderr)


def _print_licences(report: IngestReport) -> None:
    """Say where the dataset's licence differs from those that recordings state, or was taken from them."""
    if report.other_licences:
        print(
            f"licence: recordings state {', '.join(report.other_licences)}, the dataset"
            f" {report.licence or 'none'}: write that of the whole into dataset.json, or ingest into a new folder"
            " with --licence"
        )
    elif report.licence is not None:
        print(f"licence: {report.licence}")


def _print(report: IngestReport, out: str, *, dry_run: bool) -> None:
    from rich.table import Table

    from mirror.cli.output import plain_console

    # In a pipe, rows are neither wrapped nor truncated.
    console = plain_console(width=None if sys.stdout.isatty() else 10_000)
    table = Table(box=None, pad_edge=False)
    for name in ("drive", "poses", "removed", "passes", "accepted", "refused because"):
        table.add_column(name, justify="right" if name in ("poses", "removed", "passes", "accepted") else "left")
    for drive_id, drive in sorted(report.drives.items()):
        reasons = Counter(row.rule for row in drive.passes if row.rule)
        table.add_row(
            drive_id,
            f"{drive.cleaning.poses:,}",
            f"{drive.cleaning.poses - drive.cleaning.kept:,}",
            str(len(drive.passes)),
            str(sum(row.accepted for row in drive.passes)),
            ", ".join(f"{rule} x{count}" for rule, count in sorted(reasons.items())),
        )
    if report.drives:
        console.print(table)
    for drive_id, drive in sorted(report.drives.items()):
        if drive.cleaning.bad_rows:
            counts = ", ".join(f"{reason} {count}" for reason, count in drive.cleaning.bad_rows.items())
            console.print(
                f"{drive_id}: rows without a valid pose were dropped: {counts}", highlight=False, markup=False
            )
        for note in drive.info.notes:
            console.print(f"{drive_id}: {note}", highlight=False, markup=False)
        if drive.uncalibrated:
            console.print(
                f"{drive_id}: the recording declares cameras uncalibrated: {', '.join(drive.uncalibrated)}",
                highlight=False,
                markup=False,
            )
    if report.unchanged:
        console.print(f"{len(report.unchanged)} unchanged drives were skipped")
    if dry_run:
        console.print("dry run: nothing was written")
        return
    if report.maps:
        console.print(f"road maps: {', '.join(f'{scene} {outcome}' for scene, outcome in report.maps.items())}")
    if not report.drives and not report.unchanged:
        console.print(f"dataset: {out}" if report.maps else "nothing was ingested")
        return
    if report.drives and not any(drive.passes for drive in report.drives.values()):
        frames = sorted({drive.info.frame or "WGS 84" for drive in report.drives.values()})
        console.print(
            f"no drive passes a region of interest: check that the regions are in the drives' frame"
            f" ({', '.join(frames)}) and that longitude comes before latitude;"
            " `mirror rois propose` finds regions on the driven roads"
        )
    console.print(
        f"{count_of(len(report.traversals), 'traversal')}, {count_of(report.images, 'image')}"
        f" ({report.bytes / 1e6:,.1f} MB, {report.linked:,} as hard links)"
    )
    if report.without_pose:
        console.print(
            f"left out: {count_of(report.without_pose, 'image')} taken in pose gaps longer than --max-gap-s,"
            " or beyond the ends of the track"
        )
    _print_licences(report)
    if report.repeated:
        counts = ", ".join(f"{camera} {count}" for camera, count in sorted(report.repeated.items()))
        console.print(
            f"left out: images with the stamp of another image of their camera, by camera: {counts};"
            " `mirror info RECORDING` names the first",
            highlight=False,
        )
    if report.missing:
        console.print(
            f"missing: {count_of(report.missing, 'image')}: cameras pause for longer than one and a half of their"
            " periods; `mirror info RECORDING` counts them by camera"
        )
    console.print(f"dataset: {out}")
