"""``mirror report DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, UsageError


@dataclass(frozen=True)
class Arguments:
    """Write one HTML page on a dataset: pictures of every camera, maps, charts, the ledger of refused passes."""

    dataset: tyro.conf.Positional[str]
    """The dataset's folder or URL."""
    out: Path = Path("report.html")
    """The page."""
    title: str = "MIRROR dataset"
    """Its title."""
    json: bool = False
    """Print where the page is as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror report")

    folder = arguments.out.absolute().parent
    if not folder.is_dir():
        raise UsageError("no such folder", file=folder, place="--out", remedy="make it first, or name another one")

    import mirror
    from mirror.schema.folders import require_output_file
    from mirror.view.report import write_report

    require_output_file(arguments.out)
    write_report(mirror.open(arguments.dataset), arguments.out, arguments.title)
    print(json.dumps({"report": str(arguments.out)}) if arguments.json else f"report: {arguments.out}")
    return ExitCode.DONE
