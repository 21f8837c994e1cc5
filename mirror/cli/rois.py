"""``mirror rois propose RECORDING...``."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.cli.ingest import (
    RENAMED_THRESHOLDS,
    Cleaning,
    TriggerArguments,
    print_failures,
    reader_options,
    stated_thresholds,
)
from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.ingest.propose import Proposal, SparseDrives

_COMMAND = "mirror rois propose"
_EXAMPLES = (
    "mirror rois propose demo/recordings --out rois.geojson",
    "mirror rois propose demo/recordings --radius-m 100 --min-traversals 4 --json",
)


@dataclass(frozen=True)
class Propose:
    """Propose regions of interest that do not overlap, ranked by their number of drives, then of traversals."""

    recordings: Annotated[tyro.conf.Positional[tuple[Path, ...]], help_text(default="none", metavar="RECORDING...")]
    """One path per drive, or a folder of recordings."""
    out: Annotated[Path | None, help_text(default="none", metavar="FILE")] = None
    """GeoJSON file for the proposals; `mirror ingest --rois` reads it. An earlier file of proposals is replaced."""
    count: int = 10
    """Largest number of proposals."""
    radius_m: float = 200.0
    """Radius of the regions."""
    prefix: str = "roi"
    """The ids are PREFIX_1, PREFIX_2 ..., in order of rank."""
    min_traversals: int = 2
    """Leave out regions with fewer traversals."""
    reader: Annotated[str | None, help_text(default="recognised from the files", metavar="NAME")] = None
    """Reader of the recordings."""
    tz: Annotated[str | None, help_text(default="none", metavar="ZONE")] = None
    """Time zone of time stamps without one, such as Africa/Casablanca (csv reader)."""
    columns: Annotated[str | None, help_text(default="recognised from the header")] = None
    """Names of columns, such as time=Date+Time,lon=LON,lat=LAT (csv reader)."""
    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="KEY=VALUE")] = ()
    """Another option of the reader."""
    trigger: tyro.conf.OmitArgPrefixes[TriggerArguments] = field(default_factory=TriggerArguments)
    cleaning: tyro.conf.OmitArgPrefixes[Cleaning] = field(default_factory=Cleaning)
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Number of threads."""
    json: bool = False
    """Print the proposals as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    summary = "propose regions of interest from recordings"
    return run_subcommand(argv, "mirror rois", {"propose": Subcommand(summary, _propose)})


def _propose(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Propose, argv, _COMMAND, examples=_EXAMPLES, renamed=RENAMED_THRESHOLDS)
    if not arguments.recordings:
        raise UsageError("no recording given", expected="mirror rois propose RECORDING...")
    for place, number in (("--count", arguments.count), ("--min-traversals", arguments.min_traversals)):
        if number < 1:
            raise UsageError(
                f"{number}", place=place, expected="a whole number of at least 1",
                remedy=f"give another number with {place}",
            )  # fmt: skip

    from mirror.ingest.propose import propose_rois
    from mirror.ingest.request import IngestOptions
    from mirror.ingest.rois import write_rois
    from mirror.progress import progress_bar
    from mirror.recordings.discovery import find_recordings
    from mirror.remedies import complete_remedy
    from mirror.schema.folders import require_output_file

    if arguments.out is not None:
        require_output_file(arguments.out, writer=_COMMAND, mark=f'"generator": "{_COMMAND}"')
    recordings = find_recordings(arguments.recordings, arguments.reader)
    options = IngestOptions(
        reader=arguments.reader,
        reader_options=reader_options(arguments.option, tz=arguments.tz, columns=arguments.columns),
        trigger=stated_thresholds(arguments.trigger),
        cleaning=stated_thresholds(arguments.cleaning),
        workers=arguments.workers,
    )
    with progress_bar(quiet=arguments.json) as bar:
        proposals = propose_rois(
            recordings.recordings,
            count=arguments.count,
            radius_m=arguments.radius_m,
            prefix=arguments.prefix,
            options=options,
            progress=bar,
        )
    for _, error in proposals.failures:
        complete_remedy(error, _COMMAND, argv)
    ranked = [proposal for proposal in proposals.ranked if proposal.traversals >= arguments.min_traversals]
    if arguments.out is not None and ranked:
        write_rois(arguments.out, [proposal.roi for proposal in ranked], _COMMAND)
    if arguments.json:
        plain = [{**vars(proposal), "roi": proposal.roi.model_dump(exclude_none=True)} for proposal in ranked]
        failures = [{"recording": str(path), **error.to_dict()} for path, error in proposals.failures]
        sparse = None if proposals.sparse is None else vars(proposals.sparse)
        passed_over = [str(path) for path in recordings.passed_over]
        print(json.dumps({"proposals": plain, "sparse": sparse, "failures": failures, "passed_over": passed_over}))
    else:
        if ranked or len(proposals.failures) < len(recordings.recordings):
            _print(ranked, proposals.sparse, arguments)
        print_failures(proposals.failures, recordings.passed_over)
    if not proposals.failures:
        return ExitCode.DONE if ranked or arguments.out is None else ExitCode.FINDINGS
    return ExitCode.PARTLY_DONE if len(proposals.failures) < len(recordings.recordings) else ExitCode.COULD_NOT_RUN


def _print(ranked: Sequence[Proposal], sparse: SparseDrives | None, arguments: Propose) -> None:
    from rich.table import Table

    from mirror.cli.output import plain_console

    console = plain_console()
    if not ranked:
        console.print(f"no region has {arguments.min_traversals} traversals: lower --min-traversals or the thresholds")
        if arguments.out is not None:
            console.print(f"{arguments.out} is not written", soft_wrap=True)
        if sparse is not None:
            console.print(
                f"the fixes of {sparse.drives} of {sparse.of} drives are farther apart than --max-gap-s"
                f" {sparse.max_gap_s:g}, where a visit ends: try --max-gap-s {sparse.spacing_s:g}",
                soft_wrap=True,
            )
        return
    table = Table(box=None, pad_edge=False)
    for name in ("roi", "centre", "drives", "traversals", "refused", "minutes", "km"):
        table.add_column(name, justify="left" if name in ("roi", "centre") else "right")
    for proposal in ranked:
        roi = proposal.roi
        centre = f"{roi.longitude_deg:.6f}, {roi.latitude_deg:.6f}" if roi.frame is None else f"{roi.x_m}, {roi.y_m}"
        minutes, kilometres = f"{proposal.duration_s / 60:.1f}", f"{proposal.path_m / 1000:.2f}"
        figures = (proposal.drives, proposal.traversals, proposal.refused, minutes, kilometres)
        table.add_row(roi.scene_id, centre, *map(str, figures))
    console.print(table)
    if arguments.out is not None:
        console.print(f"ROIs: {arguments.out}")
