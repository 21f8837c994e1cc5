"""``mirror report DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, UsageError

_EXAMPLES = (
    "mirror report demo/dataset --out report.html",
    "mirror report demo/dataset --title 'My fleet' --out site",
)


@dataclass(frozen=True)
class Arguments:
    """Write an HTML page on a dataset: images of every camera, maps, charts and the ledger of refused passes.

    For a large dataset name a folder: the report becomes a small site with a page for each scene, and tables to filter,
    sort and save.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Path = Path("report.html")
    """HTML file to write, or a folder for a site."""
    title: str = "MIRROR dataset"
    """Title of the page."""
    aerial: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """PNG or JPEG of the ground below the maps, such as an aerial image or joined map tiles. North is up."""
    aerial_bounds: Annotated[
        tuple[float, float, float, float] | None, tyro.conf.arg(metavar="WEST SOUTH EAST NORTH")
    ] = None
    """Edges of the file of --aerial, in degrees (WGS 84)."""
    json: bool = False
    """Print the path of the page as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror report", examples=_EXAMPLES)

    is_page = arguments.out.suffix == ".html"
    folder = arguments.out.absolute().parent
    if not folder.is_dir():
        raise UsageError("no such folder", file=folder, place="--out", remedy="create it first, or name another folder")

    if (arguments.aerial is None) != (arguments.aerial_bounds is None):
        raise UsageError(
            "an image of the ground needs its bounds, and bounds need an image",
            place="--aerial and --aerial-bounds",
            expected="both or neither",
            remedy="give --aerial FILE --aerial-bounds WEST SOUTH EAST NORTH",
        )

    from mirror.dataset import open as open_dataset
    from mirror.schema.folders import require_output_file

    page = arguments.out
    aerial = None
    if arguments.aerial is not None and arguments.aerial_bounds is not None:
        from mirror.view.aerial import AerialImage

        aerial = AerialImage(arguments.aerial, arguments.aerial_bounds)
    if is_page:
        from mirror.view.report import LEDGER_HEADING, write_report

        require_output_file(page, writer="mirror report", mark=LEDGER_HEADING)
        write_report(open_dataset(arguments.dataset), page, arguments.title, aerial=aerial)
    else:
        from mirror.progress import progress_bar
        from mirror.view.report_site import write_site

        with progress_bar(quiet=arguments.json) as progress:
            page = write_site(open_dataset(arguments.dataset), page, arguments.title, aerial=aerial, progress=progress)
    print(json.dumps({"report": str(page)}) if arguments.json else f"report: {page}")
    return ExitCode.DONE
