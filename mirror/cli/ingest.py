"""``mirror ingest RECORDING... --rois FILE --out DATASET``."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, MirrorError, UsageError

if TYPE_CHECKING:
    from mirror.ingest.request import IngestReport


@dataclass(frozen=True)
class Trigger:
    """When a pass becomes a traversal. Not given: the dataset's own, for a new dataset the paper's."""

    min_duration_s: float | None = None
    """Accepted from this duration on (10)."""
    min_path_m: float | None = None
    """Accepted from this driven length on (20)."""
    min_overlap: float | None = None
    """Accepted above this share of path inside the ROI (0.9)."""
    join_gap_s: float | None = None
    """Visits at most this far apart are joined (3)."""
    max_gap_s: Annotated[float | None, tyro.conf.arg(aliases=["--max-gap"])] = None
    """A longer gap between poses ends a visit (2)."""
    min_step_m: float | None = None
    """Path counts only after moving this far (0.5)."""
    step_sigmas: float | None = None
    """... or this many sigmas of the fix, if more (6)."""
    trim_standstill_s: float | None = None
    """Longer standstills are left out (60); 0 keeps them."""


@dataclass(frozen=True)
class Cleaning:
    """How fixes are cleaned first. Not given: the dataset's own, else the defaults."""

    max_speed_mps: float | None = None
    """Faster is an outlier (70)."""
    max_acceleration_mps2: float | None = None
    """Sharper is an outlier (12)."""
    noise_m: float | None = None
    """What noise alone may do (5)."""
    backward_time: Literal["sort", "refuse"] | None = None
    """What to do with time that runs backward (sort)."""
    max_bad_rows: float | None = None
    """A drive of which a larger share of rows makes no pose is refused (0.01)."""


@dataclass(frozen=True)
class Arguments:
    """Cut recordings into traversals: every pass through a region of interest that fulfils the trigger's rules.

    Run it again after an interruption and it goes on; run it with more recordings and it appends; run it unchanged and
    it does nothing. Exit codes: 0 done, 2 could not run, 3 some recordings failed and the rest is complete.
    """

    recordings: tyro.conf.Positional[tuple[Path, ...]]
    """One path a drive: a folder or file that a reader recognises; or a folder of them."""
    out: Path | None = None
    """The dataset's folder. Needed but for --dry-run."""
    rois: Path | None = None
    """GeoJSON or CSV file of regions of interest."""
    roi: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A region as lon,lat[,radius_m[,scene_id]]; may be repeated."""
    reader: str | None = None
    """Name of the reader; default: recognised from the files."""
    tz: str | None = None
    """Time zone of stamps that name none, e.g. Africa/Casablanca (csv reader)."""
    columns: str | None = None
    """Names of columns, e.g. time=Date+Time,lon=LON,lat=LAT (csv reader)."""
    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Any other option of the reader as key=value; may be repeated."""
    weather_from: str | None = None
    """Plug-in that tells the weather from pictures, for recordings that do not state it."""
    trigger: tyro.conf.OmitArgPrefixes[Trigger] = field(default_factory=Trigger)
    cleaning: tyro.conf.OmitArgPrefixes[Cleaning] = field(default_factory=Cleaning)
    copy: bool = False
    """Copy pictures. Default: hard links where the file systems allow it, copies elsewhere."""
    hash: bool = True
    """Read and hash every picture, and refuse truncated and broken ones; without it only their headers are read."""
    verify_images: bool = False
    """Decode every image, and refuse those that no decoder reads."""
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Threads."""
    dry_run: bool = False
    """Judge only: print the ledger, write nothing."""
    verify: bool = False
    """Hash the pictures of recordings that look unchanged."""
    replace: bool = False
    """Ingest a drive anew whose recording has changed."""
    fail_fast: bool = False
    """Stop at the first recording that cannot be ingested."""
    wait: bool = False
    """Wait for another run that is writing the dataset."""
    licence: str | None = None
    """Licence of the data, noted in a new dataset."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror ingest")
    if not arguments.recordings:
        raise UsageError("no recording given", expected="mirror ingest RECORDING... --rois FILE --out DATASET")
    if arguments.out is None and not arguments.dry_run:
        raise UsageError("no dataset folder given", place="--out", expected="--out DATASET, or --dry-run")

    from mirror.ingest.request import IngestOptions
    from mirror.ingest.rois import parse_roi, read_rois
    from mirror.ingest.run import ingest_recordings
    from mirror.ingest.traversal import WriteOptions
    from mirror.progress import progress_bar
    from mirror.recordings.discovery import find_recordings

    found = find_recordings(arguments.recordings, arguments.reader)
    rois = read_rois(arguments.rois) if arguments.rois else []
    rois += [parse_roi(text) for text in arguments.roi]
    options = IngestOptions(
        reader=arguments.reader,
        reader_options=reader_options(arguments.option, tz=arguments.tz, columns=arguments.columns),
        trigger=given(arguments.trigger),
        cleaning=given(arguments.cleaning),
        weather_plugin=arguments.weather_from,
        write=WriteOptions(
            transfer="copy" if arguments.copy else "link", hashing=arguments.hash, decoding=arguments.verify_images
        ),
        workers=arguments.workers,
        dry_run=arguments.dry_run,
        verify=arguments.verify,
        replace=arguments.replace,
        fail_fast=arguments.fail_fast,
        wait=arguments.wait,
        licence=arguments.licence,
    )
    out = arguments.out or Path("dry-run")
    with progress_bar(quiet=arguments.json) as bar:
        report = ingest_recordings(found.recordings, rois, out, options, bar)
    if arguments.json:
        passed_over = [str(path) for path in found.passed_over]
        print(json.dumps({**_plain(report, out), "passed_over": passed_over}))
    else:
        _print(report, out, dry_run=arguments.dry_run)
        print_failures(report.failures, found.passed_over)
    if not report.failures:
        return ExitCode.DONE
    return ExitCode.PARTLY_DONE if report.drives or report.unchanged else ExitCode.COULD_NOT_RUN


def given(thresholds: Trigger | Cleaning) -> dict[str, object]:
    """The thresholds that were given on the command line, by name."""
    values: dict[str, object] = {name: value for name, value in vars(thresholds).items() if value is not None}
    if values.get("trim_standstill_s") == 0:
        values["trim_standstill_s"] = None
    return values


def reader_options(pairs: Sequence[str], **named: str | None) -> dict[str, str]:
    """Options for a reader from ``key=value`` words and from those that have a flag of their own.

    Raises:
        UsageError: a word is not of that form.
    """
    options = {key: value for key, value in named.items() if value is not None}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise UsageError(f"{pair!r} is not key=value", place="--option")
        options[key] = value
    return options


def _plain(report: IngestReport, out: Path) -> dict[str, object]:
    return {
        "dataset": str(out),
        "drives": {
            drive_id: {
                "cleaning": drive.cleaning.model_dump(),
                "accepted": sum(one.accepted for one in drive.passes),
                "refused": dict(Counter(one.rule for one in drive.passes if one.rule)),
                "passes": [vars(one) for one in drive.passes],
            }
            for drive_id, drive in sorted(report.drives.items())
        },
        "unchanged": report.unchanged,
        "traversals": [vars(one) for one in report.traversals],
        "images": report.images,
        "bytes": report.bytes,
        "linked": report.linked,
        "images_without_pose": report.without_pose,
        "images_missing": report.missing,
        "failures": [{"recording": str(path), **error.to_dict()} for path, error in report.failures],
    }


def print_failures(failures: Sequence[tuple[Path, MirrorError]], passed_over: Sequence[Path]) -> None:
    """Print what was not read, and why, on standard error: a line each."""
    for path in passed_over:
        print(f"passed over {path}: no reader recognises it", file=sys.stderr)
    for path, error in failures:
        # The recording is named once.
        named = error.file is not None and error.file.startswith(str(path))
        print(f"failed {error}" if named else f"failed {path}: {error}", file=sys.stderr)


def _print(report: IngestReport, out: Path, *, dry_run: bool) -> None:
    from rich.table import Table

    from mirror.cli.output import plain_console

    # Piped, a line is a line: nothing is folded or cut for want of a screen.
    console = plain_console(width=None if sys.stdout.isatty() else 10_000)
    table = Table(box=None, pad_edge=False)
    for name in ("drive", "poses", "cleaned away", "passes", "accepted", "refused because"):
        table.add_column(name, justify="right" if name in ("poses", "cleaned away", "passes", "accepted") else "left")
    for drive_id, drive in sorted(report.drives.items()):
        reasons = Counter(one.rule for one in drive.passes if one.rule)
        table.add_row(
            drive_id,
            f"{drive.cleaning.poses:,}",
            f"{drive.cleaning.poses - drive.cleaning.kept:,}",
            str(len(drive.passes)),
            str(sum(one.accepted for one in drive.passes)),
            ", ".join(f"{rule} x{count}" for rule, count in sorted(reasons.items())),
        )
    if report.drives:
        console.print(table)
    for drive_id, drive in sorted(report.drives.items()):
        if drive.cleaning.bad_rows:
            counts = ", ".join(f"{reason} {count}" for reason, count in drive.cleaning.bad_rows.items())
            console.print(f"{drive_id}: rows that make no pose were dropped: {counts}", highlight=False, markup=False)
    if report.unchanged:
        console.print(f"{len(report.unchanged)} drives unchanged, nothing to do for them")
    if dry_run:
        console.print("dry run: nothing was written")
        return
    if not report.drives and not report.unchanged:
        console.print("nothing was ingested")
        return
    if report.drives and not any(drive.passes for drive in report.drives.values()):
        frames = sorted({drive.info.frame or "WGS 84" for drive in report.drives.values()})
        console.print(
            f"no drive comes by any ROI: are they where was driven, in the drives' frame ({', '.join(frames)}),"
            " longitude before latitude? `mirror rois propose` finds places that are driven"
        )
    done = len(report.traversals)
    console.print(
        f"{done} traversals, {report.images:,} pictures ({report.bytes / 1e6:,.1f} MB, {report.linked:,} as hard links)"
    )
    if report.without_pose:
        console.print(
            f"{report.without_pose:,} images were left out: they were taken in gaps of the poses over --max-gap,"
            " or where the track broke off"
        )
    if report.missing:
        console.print(
            f"{report.missing:,} images are missing: cameras pause for longer than one and a half of their periods;"
            " `mirror info RECORDING` counts them by camera"
        )
    console.print(f"dataset: {out}")
