"""``mirror dataset publish DATASET`` and ``mirror dataset fetch URL``."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode

_PUBLISH_EXAMPLES = (
    "mirror dataset publish demo/dataset --split novel --out published",
    "mirror dataset publish demo/dataset --split novel --protocol lane-shift --name 'My street' --out published",
)
_FETCH_EXAMPLES = (
    "mirror dataset fetch published --out street",
    "mirror dataset fetch https://example.org/street --out street --json",
)


@dataclass(frozen=True)
class Publish:
    """Write a bundle of a dataset without the images that submissions are scored against.

    The bundle has a datasheet, a licence and the hash of every file. An interrupted call continues when it is repeated.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    split: Annotated[str, help_text(metavar="NAME")]
    """Split whose held-out traversals are withheld."""
    out: Annotated[str, help_text(metavar="FOLDER|URL")]
    """A new folder, the folder of an interrupted call, or a URL that fsspec writes."""
    protocol: Annotated[
        tuple[str, ...], tyro.conf.UseAppendAction, help_text(default="static-reconstruction", metavar="NAME")
    ] = ()
    """Protocol whose images are withheld too, or path of its .toml file."""
    name: Annotated[str | None, help_text(default="the folder's name", metavar="TITLE")] = None
    """Title of the dataset."""
    licence: Annotated[str | None, help_text(default="that of the dataset", metavar="SPDX")] = None
    """Licence of the data."""
    contact: Annotated[str | None, help_text(default="none", metavar="ADDRESS")] = None
    """Where to ask for the removal of data."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class Fetch:
    """Fetch a published dataset and verify every file. An interrupted call continues when it is repeated.

    Exit codes: 0 done, 2 could not run, 3 some files failed and the rest is verified.
    """

    url: tyro.conf.Positional[str]
    """Folder or URL of the bundle: https://, s3://, hf://datasets/OWNER/NAME, or any other that fsspec reads."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new folder, or the folder of an interrupted call."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "publish": Subcommand("write a bundle without held-out images", _publish),
        "fetch": Subcommand("fetch a bundle and verify it", _fetch),
    }
    return run_subcommand(argv, "mirror dataset", subcommands)


def _publish(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Publish, argv, "mirror dataset publish", examples=_PUBLISH_EXAMPLES)

    import mirror
    from mirror.export.publish import PublishOptions, publish
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol

    options = PublishOptions(
        split=arguments.split,
        protocols=tuple(load_protocol(name) for name in arguments.protocol or ("static-reconstruction",)),
        name=arguments.name or arguments.dataset.resolve().name,
        licence=arguments.licence,
        contact=arguments.contact,
    )
    with progress_bar(quiet=arguments.json) as bar:
        bundle = publish(arguments.dataset, arguments.out, options, progress=bar)
    size = sum(entry.bytes for entry in bundle.files.values())
    if arguments.json:
        written = {"out": arguments.out, "files": len(bundle.files), "bytes": size}
        print(json.dumps({**written, "withheld": len(bundle.withheld)}))
    else:
        counts = f"{len(bundle.files):,} files, {size / 1e6:,.1f} MB; {len(bundle.withheld):,} images withheld"
        print(f"{arguments.out}: {counts}")
        print("README.md is the datasheet: read it, and add what only you know, before you publish the folder")
        raw = mirror.open(arguments.dataset).table("images", ["privacy"]).column("privacy").to_pylist().count("raw")
        if raw:
            print(f"{raw:,} images of the dataset show faces and plates as recorded: publish them only if you may")
    return ExitCode.DONE


def _fetch(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Fetch, argv, "mirror dataset fetch", examples=_FETCH_EXAMPLES)

    from mirror.export.fetch import fetch
    from mirror.progress import progress_bar

    with progress_bar(quiet=arguments.json) as bar:
        report = fetch(arguments.url, arguments.out, progress=bar)
    for _, problem in report.failed:
        print(f"failed {problem}", file=sys.stderr)
    if arguments.json:
        counts = {"fetched": report.fetched, "kept": report.kept, "failed": [name for name, _ in report.failed]}
        print(json.dumps({"out": str(arguments.out), **counts, "split": report.bundle.split}))
    else:
        print(
            f"{arguments.out}: {report.fetched:,} files fetched, {report.kept:,} kept, {len(report.failed):,} failed;"
            f" licence {report.bundle.licence}, split {report.bundle.split}"
        )
    return ExitCode.PARTLY_DONE if report.failed else ExitCode.DONE
