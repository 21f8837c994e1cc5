"""``mirror report DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, UsageError

_EXAMPLES = (
    "mirror report demo/dataset --out report.html",
    "mirror report demo/block/dataset --title 'One block' --out block.html",
)


@dataclass(frozen=True)
class Arguments:
    """Write an HTML page on a dataset: images of every camera, maps, charts and the ledger of refused passes."""

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Path = Path("report.html")
    """HTML file to write."""
    title: str = "MIRROR dataset"
    """Title of the page."""
    json: bool = False
    """Print the path of the page as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror report", examples=_EXAMPLES)

    folder = arguments.out.absolute().parent
    if not folder.is_dir():
        raise UsageError("no such folder", file=folder, place="--out", remedy="create it first, or name another folder")

    import mirror
    from mirror.schema.folders import require_output_file
    from mirror.view.report import write_report

    require_output_file(arguments.out)
    write_report(mirror.open(arguments.dataset), arguments.out, arguments.title)
    print(json.dumps({"report": str(arguments.out)}) if arguments.json else f"report: {arguments.out}")
    return ExitCode.DONE
