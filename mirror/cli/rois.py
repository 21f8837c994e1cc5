"""``mirror rois propose RECORDING...``."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.cli.ingest import Cleaning, Trigger, given, print_failures, reader_options
from mirror.command_line import Subcommand, parse_arguments, run_subcommand
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.ingest.propose import Proposal, Sparse


@dataclass(frozen=True)
class Propose:
    """Rank centres of regions of interest by how many drives have a traversal there, then by traversals, no overlap."""

    recordings: tyro.conf.Positional[tuple[Path, ...]]
    """One path a drive, or a folder of recordings."""
    out: Path | None = None
    """Write the proposals here, as the GeoJSON that `mirror ingest --rois` takes."""
    count: int = 10
    """How many at most."""
    radius_m: float = 200.0
    """Radius of the regions."""
    prefix: str = "roi"
    """Ids are prefix_1, prefix_2 ..., best first."""
    min_traversals: int = 2
    """Leave out places with fewer accepted passes."""
    reader: str | None = None
    """Name of the reader; default: recognised from the files."""
    tz: str | None = None
    """Time zone of stamps that name none (csv reader)."""
    columns: str | None = None
    """Names of columns (csv reader)."""
    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Any other option of the reader as key=value; may be repeated."""
    trigger: tyro.conf.OmitArgPrefixes[Trigger] = field(default_factory=Trigger)
    cleaning: tyro.conf.OmitArgPrefixes[Cleaning] = field(default_factory=Cleaning)
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Threads."""
    json: bool = False
    """Print the proposals as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    summary = "propose regions of interest from recordings"
    return run_subcommand(argv, "mirror rois", {"propose": Subcommand(summary, _propose)})


def _propose(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Propose, argv, "mirror rois propose")
    if not arguments.recordings:
        raise UsageError("no recording given", expected="mirror rois propose RECORDING...")

    from mirror.ingest.propose import propose_rois
    from mirror.ingest.request import IngestOptions
    from mirror.ingest.rois import write_rois
    from mirror.progress import progress_bar
    from mirror.recordings.discovery import find_recordings
    from mirror.schema.folders import require_output_file

    if arguments.out is not None:
        require_output_file(arguments.out)
    recordings = find_recordings(arguments.recordings, arguments.reader)
    options = IngestOptions(
        reader=arguments.reader,
        reader_options=reader_options(arguments.option, tz=arguments.tz, columns=arguments.columns),
        trigger=given(arguments.trigger),
        cleaning=given(arguments.cleaning),
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
    found = [one for one in proposals.ranked if one.traversals >= arguments.min_traversals]
    if arguments.out is not None and found:
        write_rois(arguments.out, [one.roi for one in found])
    if arguments.json:
        plain = [{**vars(one), "roi": one.roi.model_dump(exclude_none=True)} for one in found]
        failures = [{"recording": str(path), **error.to_dict()} for path, error in proposals.failures]
        sparse = None if proposals.sparse is None else vars(proposals.sparse)
        passed_over = [str(path) for path in recordings.passed_over]
        print(json.dumps({"proposals": plain, "sparse": sparse, "failures": failures, "passed_over": passed_over}))
    else:
        if found or len(proposals.failures) < len(recordings.recordings):
            _print(found, proposals.sparse, arguments)
        print_failures(proposals.failures, recordings.passed_over)
    if not proposals.failures:
        return ExitCode.DONE
    return ExitCode.PARTLY_DONE if len(proposals.failures) < len(recordings.recordings) else ExitCode.COULD_NOT_RUN


def _print(found: Sequence[Proposal], sparse: Sparse | None, arguments: Propose) -> None:
    from rich.table import Table

    from mirror.cli.output import plain_console

    console = plain_console()
    if not found:
        console.print(f"no place has {arguments.min_traversals} traversals: lower --min-traversals or the thresholds")
        if sparse is not None:
            console.print(
                f"the fixes of {sparse.drives} of {sparse.of} drives lie farther apart than --max-gap"
                f" {sparse.max_gap_s:g}, at which a visit ends: try --max-gap {sparse.spacing_s:g}",
                soft_wrap=True,
            )
        return
    table = Table(box=None, pad_edge=False)
    for name in ("roi", "centre", "drives", "traversals", "refused", "minutes", "km"):
        table.add_column(name, justify="left" if name in ("roi", "centre") else "right")
    for one in found:
        roi = one.roi
        centre = f"{roi.longitude_deg:.6f}, {roi.latitude_deg:.6f}" if roi.frame is None else f"{roi.x_m}, {roi.y_m}"
        figures = (one.drives, one.traversals, one.refused, f"{one.duration_s / 60:.1f}", f"{one.path_m / 1000:.2f}")
        table.add_row(roi.scene_id, centre, *map(str, figures))
    console.print(table)
    if arguments.out is not None:
        console.print(f"ROIs: {arguments.out}")
