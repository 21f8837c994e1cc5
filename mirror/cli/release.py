"""``mirror release check|review|build|withdraw``."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from mirror.privacy.release.check import ReleaseFinding

_LISTED: Final = 5
_CHECK: Final = (
    "mirror release check release",
    "mirror release check release --detector centerface --detector world_plates --originals demo/dataset",
)
_REVIEW: Final = (
    "mirror release review demo/dataset --reviewer anna",
    "mirror release review demo/dataset --sample 600",
)
_BUILD: Final = (
    "mirror release build demo/dataset --name street --licence CC-BY-4.0 --contact privacy@example.org --out release",
    "mirror release build demo/dataset --name street --licence CC-BY-4.0 --contact privacy@example.org --clock day"
    " --trim-ends-s 60 --vault vault --out release",
)
_WITHDRAW: Final = (
    "mirror release withdraw release guangzhou-urban.drive-1.1763596800000 --out release-2",
    "mirror release withdraw release guangzhou-urban.drive-1.1763596800000/rear/1763596801000000000 --out release-2",
)


@dataclass(frozen=True)
class CheckArguments:
    """Check a release before it is published. Nothing is changed.

    Without --detector the images are not searched again, and without --originals or --vault they are not compared with
    the originals. Exit codes: 0 nothing found, 1 findings, 2 could not run.
    """

    release: tyro.conf.Positional[Path]
    """Folder of the release."""
    detector: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME[=FILE]")] = ()
    """A detector that searches the images again; what it finds must be covered by logged regions."""
    originals: Annotated[Path | None, help_text(default="not compared")] = None
    """The dataset that the release was built of."""
    vault: Annotated[Path | None, help_text(default="not compared")] = None
    """A vault with the hashes of originals."""
    model: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction, help_text(metavar="FOLDER")] = ()
    """A model that is to be published with the release."""
    workers: Annotated[int | None, help_text(default="one a core")] = None
    """Number of processes of the detectors."""
    timeout_s: float = 120.0
    """Longest time that the detectors may take for one image."""
    json: bool = False
    """Print the report as JSON."""


@dataclass(frozen=True)
class ReviewArguments:
    """Review a sample of redacted images on a page in a browser. Every answer is written at once.

    Without a miss in N images, at most 3 / N of all images have one, with 95 % confidence.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the de-identified dataset."""
    reviewer: str = "reviewer"
    """Name or pseudonym for the log."""
    sample: int = 300
    """Number of images."""
    port: Annotated[int, help_text(default="a free one")] = 0
    """Port on this machine."""


@dataclass(frozen=True)
class BuildArguments:
    """Build a release of a de-identified dataset: redacted images only, with log, datasheet and licence.

    It is refused where a check fails. Exit codes: 0 built, 1 refused, 2 could not run.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the de-identified dataset."""
    out: Path
    """Folder of the release: a new or an empty one."""
    name: str
    """Name of the release."""
    licence: str
    """Licence of the data, such as CC-BY-NC-4.0."""
    contact: str
    """Where persons ask for the removal of an image, such as an address of mail."""
    sample: int = 300
    """Number of images that persons must have reviewed; 0: none."""
    clock: Literal["exact", "hour", "day", "week"] = "exact"
    """Shift the clock of each drive so that it begins at a full hour, day or week."""
    trim_ends_s: float = 0.0
    """Leave out traversals nearer in time than this to an end of their drive: homes and places of work."""
    keep_ids: bool = False
    """Keep the ids of drives and vehicles. Without it they get pseudonyms of this release."""
    vault: Annotated[Path | None, help_text(default="not kept")] = None
    """Folder outside of dataset and release for the key of the pseudonyms and the hashes of originals."""
    retain_days: Annotated[int | None, help_text(default="not stated")] = None
    """Days after which a new vault is to be deleted."""
    plate_region: Annotated[str | None, help_text(default="that of `mirror deidentify`")] = None
    """Region of the number plates, for the datasheet. Another one than that of the de-identification is refused."""
    wait: bool = False
    """Wait until no other run writes the dataset."""
    json: bool = False
    """Print the report as JSON."""


@dataclass(frozen=True)
class WithdrawArguments:
    """Write the next version of a release, without some images or traversals. The present version is not changed."""

    release: tyro.conf.Positional[Path]
    """Folder of the release."""
    items: Annotated[tyro.conf.Positional[tuple[str, ...]], help_text(default="at least one")]
    """Ids of traversals, or TRAVERSAL/CAMERA/TIMESTAMP_NS of images."""
    out: Path
    """Folder of the next version: a new or an empty one."""
    reason: Annotated[str, help_text(default="not stated")] = ""
    """Why, for the tombstones."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    return run_subcommand(
        argv,
        "mirror release",
        {
            "check": Subcommand("check a release before it is published", _check),
            "review": Subcommand("review a sample of redacted images on a page", _review),
            "build": Subcommand("build a release of a de-identified dataset", _build),
            "withdraw": Subcommand("write the next version, without some images or traversals", _withdraw),
        },
    )


def _check(words: Sequence[str]) -> int:
    arguments = parse_arguments(CheckArguments, words, "mirror release check", examples=_CHECK)

    from mirror.pools import usable_cores
    from mirror.privacy.detectors.registry import parse_choice
    from mirror.privacy.release.check import check_release
    from mirror.progress import progress_bar

    with progress_bar(quiet=arguments.json) as bar:
        report = check_release(
            arguments.release,
            detectors=[parse_choice(text) for text in arguments.detector],
            originals=arguments.originals,
            vault=arguments.vault,
            models=arguments.model,
            workers=arguments.workers or usable_cores(),
            timeout_s=arguments.timeout_s,
            progress=bar,
        )
    code = report.exit_code()
    if arguments.json:
        plain = {**vars(report), "findings": [vars(one) for one in report.findings], "exit_code": int(code)}
        print(json.dumps(plain))
        return code
    _print_findings(report.findings)
    for text in report.not_run:
        print(f"could not be searched: {text}")
    compared = arguments.originals is not None or arguments.vault is not None
    print(
        f"{report.rules} rules, {report.images:,} images, {report.searched:,} searched again,"
        f" {'compared' if compared else 'not compared'} with originals: {len(report.findings)} findings"
    )
    return code


def _print_findings(findings: Sequence[ReleaseFinding]) -> None:
    ordered = sorted(findings, key=lambda one: (one.rule_id, one.file))
    for _, group in groupby(ordered, key=lambda one: one.rule_id):
        own = list(group)
        print(f"{own[0].rule_id} {own[0].title}")
        for one in own[:_LISTED]:
            print(f"  {one.file}: {one.message}")
        if len(own) > _LISTED:
            print(f"  ... and {len(own) - _LISTED} more; --json lists all")
        print(f"  remedy: {own[0].remedy}")


def _review(words: Sequence[str]) -> int:
    arguments = parse_arguments(ReviewArguments, words, "mirror release review", examples=_REVIEW)

    from mirror.addresses import require_listening
    from mirror.privacy.release.review import ReviewSession, review_server

    require_listening("127.0.0.1", arguments.port)
    session = ReviewSession(arguments.dataset, arguments.reviewer, arguments.sample)
    with review_server(session, arguments.port) as server:
        print(f"{session.done} of {len(session.sample)} images are reviewed. Open this address, and end with Ctrl-C:")
        print(f"http://127.0.0.1:{server.server_address[1]}/?token={session.token}", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            # That is how a review ends; everything is written.
            print(f"\n{session.done} of {len(session.sample)} images are reviewed", file=sys.stderr)
            raise
    return ExitCode.DONE


def _build(words: Sequence[str]) -> int:
    arguments = parse_arguments(BuildArguments, words, "mirror release build", examples=_BUILD)

    from mirror.privacy.release.build import ReleaseOptions, build_release
    from mirror.progress import progress_bar

    options = ReleaseOptions(
        name=arguments.name,
        licence=arguments.licence,
        contact=arguments.contact,
        sample=arguments.sample,
        clock=arguments.clock,
        trim_ends_s=arguments.trim_ends_s,
        keep_ids=arguments.keep_ids,
        vault=arguments.vault,
        retain_days=arguments.retain_days,
        plate_region=arguments.plate_region,
    )
    with progress_bar(quiet=arguments.json) as bar:
        report = build_release(arguments.dataset, arguments.out, options, progress=bar, wait=arguments.wait)
    code = ExitCode.FINDINGS if report.findings else ExitCode.DONE
    if arguments.json:
        plain = {
            "release": report.release.model_dump(),
            "images": report.images,
            "traversals": report.traversals,
            "left_out": list(report.left_out),
            "findings": [vars(one) for one in report.findings],
            "exit_code": int(code),
        }
        print(json.dumps(plain))
        return code
    _print_findings(report.findings)
    for name in report.left_out:
        print(f"left out, as it was derived from other images: {name}")
    if report.findings:
        print(f"refused: {len(report.findings)} findings; nothing was written")
        return code
    print(f"{report.traversals} traversals, {report.images:,} images, {report.release.withheld:,} withheld")
    print(f"release: {arguments.out}")
    return code


def _withdraw(words: Sequence[str]) -> int:
    arguments = parse_arguments(WithdrawArguments, words, "mirror release withdraw", examples=_WITHDRAW)

    from mirror.privacy.release.withdraw import withdraw

    release = withdraw(arguments.release, arguments.items, arguments.out, reason=arguments.reason)
    if arguments.json:
        print(json.dumps(release.model_dump()))
        return ExitCode.DONE
    print(f"{len(arguments.items)} withdrawn: version {release.version} of {release.name}: {arguments.out}")
    return ExitCode.DONE
