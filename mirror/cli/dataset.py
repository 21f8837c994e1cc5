"""``mirror dataset publish|migrate|gc|take-down DATASET``, ``... fetch URL``, ``... audit PUBLISHED``."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from mirror.command_line import Subcommand, help_text, is_url, parse_arguments, run_subcommand
from mirror.counting import count_of
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from mirror.dataset.door.inspection import Leak, SameBytes

_LISTED: Final = 5
_PUBLISH_EXAMPLES = (
    "mirror dataset publish demo/dataset --split novel --out published",
    "mirror dataset publish demo/dataset --split novel --protocol lane-shift --name 'My street' --out published",
)
_FETCH_EXAMPLES = (
    "mirror dataset fetch published --out street",
    "mirror dataset fetch s3://fleet/street --camera front_wide --light night --out nights --json",
)
_MIGRATE_EXAMPLES = ("mirror dataset migrate demo/dataset", "mirror dataset migrate demo/dataset --json")
_GC_EXAMPLES = (
    "mirror dataset gc demo/dataset --dry-run",
    "mirror dataset gc demo/dataset --older-than-days 30 --json",
)
_AUDIT_EXAMPLES = (
    "mirror dataset audit published --against demo/dataset",
    "mirror dataset audit https://example.org/street --against demo/dataset --json",
)


@dataclass(frozen=True)
class Publish:
    """Write a bundle of a dataset without the images that submissions are scored against.

    The bundle has a datasheet, Croissant metadata, a licence and the hash of every file. An interrupted call continues
    when it is repeated.
    Every file is held against all images that stay, before the bundle is sealed.

    Exit codes: 0 done, 1 a file must not leave and nothing was sealed, 2 could not run.
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
    masks: bool = True
    """--no-masks: road users are scored, by the protocol NAME-unmasked, for recordings without boxes and masks."""
    name: Annotated[str | None, help_text(default="the folder's name", metavar="TITLE")] = None
    """Title of the dataset."""
    licence: Annotated[str | None, help_text(default="that of the dataset", metavar="SPDX")] = None
    """Licence of the data."""
    contact: Annotated[str | None, help_text(default="none", metavar="ADDRESS")] = None
    """Where to ask for the removal of data."""
    url: Annotated[str | None, help_text(default="none", metavar="URL")] = None
    """Page of the dataset, for croissant.json."""
    creator: Annotated[str | None, help_text(default="none", metavar="NAME")] = None
    """Who made the dataset, for croissant.json."""
    date: Annotated[str | None, help_text(default="none", metavar="YYYY-MM-DD")] = None
    """Day of the publication, for croissant.json."""
    citation: Annotated[str | None, help_text(default="its name, and the paper", metavar="TEXT")] = None
    """How the dataset is cited, such as BibTeX, for croissant.json."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class Fetch:
    """Fetch a published dataset and verify every file. An interrupted call continues when it is repeated.

    With --scene, --camera or --light, a part of any dataset is fetched, as a dataset of its own.

    Exit codes: 0 done, 2 could not run, 3 some files failed and the rest is verified.
    """

    url: tyro.conf.Positional[str]
    """Folder or URL of the bundle: https://, s3://, hf://datasets/OWNER/NAME, or any other that fsspec reads."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new folder, or the folder of an interrupted call."""
    scene: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="ID")] = ()
    """Only this scene."""
    camera: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME")] = ()
    """Only this camera."""
    light: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="day|dusk|night")] = ()
    """Only traversals in this light."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class Audit:
    """Search a published dataset for content of its source that must not be out. Nothing is changed.

    Of a published dataset, every file must be one that publishing would copy today, and every image must have the bytes
    that it has in the dataset. Releases, exports, models and pages are searched for images that must not leave.

    Exit codes: 0 nothing found, 1 findings, 2 could not run.
    """

    published: tyro.conf.Positional[str]
    """Folder or URL of a published dataset, or a folder with a release, an export, a model or pages."""
    against: Annotated[Path, help_text(metavar="DATASET")]
    """Folder of the complete dataset."""
    split: Annotated[str | None, help_text(default="that of the published dataset", metavar="NAME")] = None
    """Split whose held-out traversals are withheld."""
    protocol: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME")] = ()
    """Protocol whose images are withheld too, or path of its .toml file."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class Migrate:
    """Bring a dataset of an earlier version of MIRROR up to date: its index gets snapshots.

    Drives, traversals, layers, maps and splits stay byte for byte. An interrupted call continues when it is repeated.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    wait: bool = False
    """Wait until no other run writes the dataset. Without it, a dataset that is being written is an error."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class Gc:
    """Remove what no reader can reach: old snapshots, index segments that none names, traversals that no drive names.

    The newest snapshot stays, and each that a process of this machine has open. Drives and images of drives stay. Of a
    bucket the age alone decides: readers of it are not known.
    """

    dataset: tyro.conf.Positional[str]
    """Folder of the dataset, or s3://BUCKET/PATH."""
    older_than_days: float = 7.0
    """Keep what was changed within so many days: a run on another machine may be about to name it."""
    dry_run: bool = False
    """Print what would be removed. Nothing is removed."""
    wait: bool = False
    """Wait until no other run writes the dataset. Without it, a dataset that is being written is an error."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "publish": Subcommand("write a bundle without held-out images", _publish),
        "fetch": Subcommand("fetch a bundle and verify it", _fetch),
        "migrate": Subcommand("bring a dataset of an earlier version up to date", _migrate),
        "gc": Subcommand("remove old snapshots, and what nothing names", _gc),
        "take-down": Subcommand("remove images from a dataset and its publications", _take_down),
        "audit": Subcommand("hold what is published against its dataset", _audit),
    }
    return run_subcommand(argv, "mirror dataset", subcommands)


def _publish(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Publish, argv, "mirror dataset publish", examples=_PUBLISH_EXAMPLES)

    from mirror.export.croissant import Publication
    from mirror.export.publish import PublishOptions, publish
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol

    publication = Publication(_page(arguments.url), arguments.creator, _iso_date(arguments.date), arguments.citation)
    options = PublishOptions(
        split=arguments.split,
        protocols=tuple(
            load_protocol(name, masked=arguments.masks) for name in arguments.protocol or ("static-reconstruction",)
        ),
        name=arguments.name or arguments.dataset.resolve().name,
        licence=arguments.licence,
        contact=arguments.contact,
        publication=publication,
    )
    with progress_bar(quiet=arguments.json) as bar:
        report = publish(arguments.dataset, arguments.out, options, progress=bar)
    bundle = report.bundle
    if bundle is None:
        return _refuse(report.leaks, arguments.json)
    size = sum(entry.bytes for entry in bundle.files.values())
    if arguments.json:
        same = [one._asdict() for one in report.same_bytes]
        written = {"out": arguments.out, "files": len(bundle.files), "bytes": size, "withheld": len(bundle.withheld)}
        print(json.dumps({**written, "as_recorded": report.as_recorded, "same_bytes": same, "altered": report.altered}))
        return ExitCode.DONE
    counts = f"{len(bundle.files):,} files, {size / 1e6:,.1f} MB; {len(bundle.withheld):,} images withheld"
    print(f"{arguments.out}: {counts}")
    print("README.md is the datasheet, croissant.json the metadata: read both before you publish the folder")
    unsaid = [*publication.missing(), *(["--contact"] if options.contact is None else [])]
    if unsaid:
        print(
            f"they lack what only you know: run it again with {', '.join(unsaid)} (a file that is edited fails `fetch`)"
        )
    _print_same(report.same_bytes)
    if report.altered:
        print(f"{len(report.altered):,} images have other bytes than their table states, such as {report.altered[0]}")
    if report.as_recorded:
        print(f"{report.as_recorded:,} images show faces and plates as recorded: publish them only if you may")
    return ExitCode.DONE


def _migrate(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Migrate, argv, "mirror dataset migrate", examples=_MIGRATE_EXAMPLES)

    from dataclasses import asdict

    from mirror.dataset.migration import migrate
    from mirror.schema.version import DATASET_VERSION

    report = migrate(arguments.dataset, wait=arguments.wait)
    if arguments.json:
        print(json.dumps({**asdict(report), "version": DATASET_VERSION}))
    elif report.index is None:
        print(f"{arguments.dataset}: version {report.before}, nothing to do")
    else:
        print(f"{arguments.dataset}: version {report.before} -> {DATASET_VERSION}, snapshot {report.index.snapshot}")
    return ExitCode.DONE


def _gc(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Gc, argv, "mirror dataset gc", examples=_GC_EXAMPLES)

    from dataclasses import asdict

    from mirror.dataset.bucket_garbage import collect_bucket_garbage
    from mirror.dataset.destination import bucket_at
    from mirror.dataset.garbage import collect_garbage
    from mirror.errors import UsageError

    if not arguments.older_than_days >= 0.0:
        raise UsageError(f"{arguments.older_than_days}", place="--older-than-days", expected="0 or more")
    age_s = arguments.older_than_days * 86400.0
    if is_url(arguments.dataset):
        bucket = bucket_at(arguments.dataset)
        report = collect_bucket_garbage(bucket, age_s=age_s, dry_run=arguments.dry_run, wait=arguments.wait)
    else:
        folder = Path(arguments.dataset)
        report = collect_garbage(folder, age_s=age_s, dry_run=arguments.dry_run, wait=arguments.wait)
    if arguments.json:
        print(json.dumps({**asdict(report), "dry_run": arguments.dry_run}))
        return ExitCode.DONE
    numbers = {"snapshot": report.snapshots, "segment": report.segments, "traversal": report.traversals}
    counts = ", ".join(count_of(len(found), name) for name, found in numbers.items())
    verb = "would be removed" if arguments.dry_run else "removed"
    print(f"{arguments.dataset}: {counts}, {report.bytes / 1e6:,.1f} MB {verb}")
    return ExitCode.DONE


def _take_down(argv: Sequence[str]) -> int:
    from mirror.cli.take_down import main as run

    return run(argv)


def _page(url: str | None) -> str | None:
    """Return the address of a page if it is one."""
    from urllib.parse import urlsplit

    from mirror.errors import UsageError

    if url is not None and (urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).hostname):
        raise UsageError(
            f"{url!r}", place="--url", expected="the address of a page, such as https://example.org/street"
        )
    return url


def _iso_date(text: str | None) -> str | None:
    """Return a date if it is one."""
    from datetime import date

    from mirror.errors import UsageError

    try:
        return None if text is None else date.fromisoformat(text).isoformat()
    except ValueError as error:
        raise UsageError(f"{text!r}", place="--date", expected="a date such as 2026-03-01") from error


def _refuse(leaks: Sequence[Leak], as_json: bool) -> int:
    """Print the files that must not leave."""
    if as_json:
        print(json.dumps({"leaks": [one._asdict() for one in leaks]}))
        return ExitCode.FINDINGS
    _print_leaks(leaks)
    print(f"refused: {len(leaks):,} findings; nothing was sealed")
    return ExitCode.FINDINGS


def _print_leaks(leaks: Sequence[Leak]) -> None:
    for one in leaks[:_LISTED]:
        print(f"{one.file}: {one.problem}")
    if len(leaks) > _LISTED:
        print(f"... and {len(leaks) - _LISTED:,} more; --json lists all")


def _print_same(same_bytes: Sequence[SameBytes]) -> None:
    for one in same_bytes[:_LISTED]:
        print(f"{one.shown} is published and has the bytes of {one.kept}, {one.why}")
    if len(same_bytes) > _LISTED:
        print(f"... and {len(same_bytes) - _LISTED:,} more; --json lists all")


def _audit(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Audit, argv, "mirror dataset audit", examples=_AUDIT_EXAMPLES)

    from mirror.export.audit import audit
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol

    protocols = tuple(load_protocol(name) for name in arguments.protocol)
    with progress_bar(quiet=arguments.json) as bar:
        report = audit(arguments.published, arguments.against, split=arguments.split, protocols=protocols, progress=bar)
    if arguments.json:
        leaks, same = ([one._asdict() for one in found] for found in (report.leaks, report.same_bytes))
        print(json.dumps({"files": report.files, "leaks": leaks, "same_bytes": same}))
        return report.exit_code()
    _print_leaks(report.leaks)
    _print_same(report.same_bytes)
    print(f"{report.files:,} files, {len(report.leaks):,} findings")
    if report.leaks:
        print("take it down, publish the dataset again, and tell those who fetched it (SECURITY.md)")
    return report.exit_code()


def _fetch(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Fetch, argv, "mirror dataset fetch", examples=_FETCH_EXAMPLES)

    from mirror.export.fetch import fetch
    from mirror.progress import progress_bar

    if arguments.scene or arguments.camera or arguments.light:
        return _fetch_part(arguments)
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


def _fetch_part(arguments: Fetch) -> int:
    from dataclasses import asdict

    from mirror.export.part import fetch_part
    from mirror.progress import progress_bar

    with progress_bar(quiet=arguments.json) as bar:
        report = fetch_part(
            arguments.url, arguments.out, scenes=arguments.scene, cameras=arguments.camera, lights=arguments.light,
            progress=bar,
        )  # fmt: skip
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), **asdict(report)}))
    else:
        print(
            f"{arguments.out}: {report.traversals:,} traversals ({report.kept:,} kept), {report.images:,} images,"
            f" {report.bytes / 1e6:,.1f} MB fetched"
        )
    return ExitCode.DONE
