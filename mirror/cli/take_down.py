"""``mirror dataset take-down DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.counting import count_of
from mirror.errors import ExitCode

_EXAMPLES = (
    "mirror dataset take-down demo/dataset --image street.drive-1.1763596800000/rear/1763596801000000000 --dry-run",
    "mirror dataset take-down demo/dataset --list requests.txt --reason 'request 7' --publication published",
)


@dataclass(frozen=True)
class Arguments:
    """Take images down: no reader gets them any more, and redaction layers and publications lose their bytes.

    Snapshots of the index that have their rows are refused from then on, with the reason. Other images and all tables
    stay as they are: in archives zeros take the place of the images. An interrupted call continues when it is repeated.

    Exit codes: 0 done, 2 could not run.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    image: Annotated[
        tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="TRAVERSAL/CAMERA/TIMESTAMP_NS")
    ] = ()
    """An image."""
    list: Annotated[Path | None, help_text(metavar="FILE", default="none")] = None
    """A text file with an image a line; lines that begin with # are comments."""
    reason: str = ""
    """Why. Who opens a snapshot that lost rows gets it; it is not published."""
    publication: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction, help_text(metavar="FOLDER")] = ()
    """A published dataset, of which the images are taken down too."""
    purge_originals: bool = False
    """Remove the recorded bytes too. Without it only redaction layers and publications lose bytes."""
    dry_run: bool = False
    """Print what would be changed. Nothing is changed."""
    wait: bool = False
    """Wait until no other run writes the dataset. Without it, a dataset that is being written is an error."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror dataset take-down", examples=_EXAMPLES)

    from dataclasses import asdict

    from mirror.dataset.store import Store
    from mirror.dataset.take_down import take_down
    from mirror.dataset.taken_down import parse_image, read_image_list, read_take_downs
    from mirror.export.take_down import require_publication, take_down_published

    images = {parse_image(text, "--image") for text in arguments.image}
    if arguments.list is not None:
        images |= read_image_list(arguments.list)
    for folder in arguments.publication:
        require_publication(folder)
    report = take_down(
        arguments.dataset, images, reason=arguments.reason, purge_originals=arguments.purge_originals,
        dry_run=arguments.dry_run, wait=arguments.wait,
    )  # fmt: skip
    take_downs = read_take_downs(Store(arguments.dataset))
    published = [
        take_down_published(folder, take_downs, images, dry_run=arguments.dry_run, wait=arguments.wait)
        for folder in arguments.publication
    ]
    if arguments.json:
        found = {**asdict(report), "publications": [asdict(one) for one in published], "dry_run": arguments.dry_run}
        print(json.dumps(found))
        return ExitCode.DONE
    would = "would be " if arguments.dry_run else ""
    print(
        f"{arguments.dataset}: {count_of(report.images, 'image')} {would}taken down ({report.new} new),"
        f" {count_of(len(report.purged), 'file')} {would}purged"
    )
    if report.snapshots:
        print(f"snapshots that lose rows, and are refused: {', '.join(map(str, report.snapshots))}")
    for one in published:
        print(f"{one.folder}: {count_of(one.images, 'image')}, {count_of(len(one.purged), 'file')} {would}purged")
    if report.originals:
        print(f"the recorded bytes stay in {count_of(len(report.originals), 'file')}, such as {report.originals[0]}")
        print("--purge-originals removes those in the dataset; what lies elsewhere is removed by its owner")
    return ExitCode.DONE
