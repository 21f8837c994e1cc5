"""``mirror submission new DATASET``, ``check DATASET SUBMISSION`` and ``hidden DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.counting import count_of
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.evaluation.submission.check import SubmissionCheck
    from mirror.evaluation.submission.untrusted import UntrustedFiles
    from mirror.protocols.document import Protocol

_LISTED_PROBLEMS = 8
_NEW_EXAMPLES = (
    "mirror submission new demo/dataset --protocol static-reconstruction --split novel --out template",
    "mirror submission new demo/dataset --protocol lane-shift --split novel --blind --out template",
)
_CHECK_EXAMPLES = (
    "mirror submission check demo/dataset demo/submissions/nearest_frame",
    "mirror submission check demo/dataset demo/submissions/nearest_frame --decode --json",
)
_HIDDEN_EXAMPLES = (
    "mirror submission hidden demo/dataset --split novel --recordings demo/recordings --out hidden",
    "mirror submission hidden street --split novel --recordings recordings --protocol editing-accuracy --out hidden",
)


@dataclass(frozen=True)
class SubmissionArguments:
    """Write the template of a submission: each expected file with pose, lens, size and mask, and a manifest."""

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    protocol: Annotated[str, help_text(metavar="NAME")]
    """Name of a protocol, or path of its .toml file."""
    split: Annotated[str, help_text(metavar="NAME")]
    """Name of the split."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new or empty folder, or the folder of an interrupted run with the same options."""
    masks: bool = True
    """--no-masks: road users are scored, by the protocol NAME-unmasked, for recordings without boxes and masks."""
    blind: bool = False
    """Leave out the paths of recorded images, for participants who do not have the dataset."""
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class SubmissionCheckArguments:
    """Check the files and the manifest of a submission, and list all problems. Nothing is scored.

    Exit codes: 0 no problems, 1 problems, 2 could not run.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    submission: tyro.conf.Positional[Path]
    """Folder of the submission, or a zip file of it."""
    protocol: Annotated[str | None, help_text(default="that of the manifest", metavar="NAME")] = None
    """Name of a protocol, or path of its .toml file."""
    split: Annotated[str | None, help_text(default="that of the manifest", metavar="NAME")] = None
    """Name of the split."""
    decode: bool = False
    """Also decode every image. It takes minutes; the other checks take seconds."""
    json: bool = False
    """Print the report as JSON."""


@dataclass(frozen=True)
class Hidden:
    """Render the true images of moved cameras and edited vehicles in a synthetic street: `mirror evaluate --hidden`."""

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset. Its recordings were written by `mirror synth`."""
    split: Annotated[str, help_text(metavar="NAME")]
    """Name of the split."""
    recordings: Annotated[Path, help_text(metavar="FOLDER")]
    """The --out folder of `mirror synth`: it has the preset and the seed, public or secret."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new or empty folder, or the folder of an interrupted run. Do not publish it."""
    protocol: Annotated[str, help_text(metavar="NAME")] = "lane-shift"
    """Name of a protocol, or path of its .toml file."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "new": Subcommand("write the template of a submission", _new),
        "check": Subcommand("check the files of a submission, without scoring them", _check),
        "hidden": Subcommand("render the hidden truth of a synthetic street, for organisers", _hidden),
    }
    return run_subcommand(argv, "mirror submission", subcommands)


def _new(argv: Sequence[str]) -> int:
    arguments = parse_arguments(SubmissionArguments, argv, "mirror submission new", examples=_NEW_EXAMPLES)

    from mirror.dataset import open as open_dataset
    from mirror.evaluation.submission.template import write_template
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.truth.source import GroundTruth
    from mirror.protocols.views import plan_views

    dataset, protocol = open_dataset(arguments.dataset), load_protocol(arguments.protocol, masked=arguments.masks)
    plan = plan_views(dataset, protocol, arguments.split)
    truth = GroundTruth(dataset, protocol, plan.layers)
    with progress_bar(quiet=arguments.json) as bar:
        bar.start("views", len(plan.views))
        count = write_template(arguments.out, plan, truth, blind=arguments.blind, advance=bar.advance)
    if arguments.json:
        written = {"out": str(arguments.out), "expected": count, "groups_without_views": plan.empty_groups}
        print(json.dumps({**written, "protocol_hash": protocol.hash, "plan_hash": plan.hash}))
    else:
        print(f"{count} files are expected: {arguments.out}/views.json lists them, README.md explains the next steps")
        for group in plan.empty_groups:
            print(f"group {group} has no views in split {arguments.split}")
    return ExitCode.DONE


def _check(argv: Sequence[str]) -> int:
    arguments = parse_arguments(
        SubmissionCheckArguments,
        argv,
        "mirror submission check",
        examples=_CHECK_EXAMPLES,
        renamed={"--truth": "DATASET"},
    )

    from mirror.dataset import open as open_dataset
    from mirror.evaluation.submission.check import check_submission
    from mirror.evaluation.submission.untrusted import open_untrusted
    from mirror.progress import progress_bar
    from mirror.protocols.views import plan_views

    files = open_untrusted(arguments.submission)
    requested = requested_views(files, arguments.protocol, arguments.split)
    if isinstance(requested, tuple):
        protocol, split = requested
        stated = load_requested_protocol(protocol, arguments.protocol)
        plan = plan_views(open_dataset(arguments.dataset), stated, split)
        with progress_bar(quiet=arguments.json) as bar:
            bar.start("files", len(plan.views))
            report = check_submission(files, plan, decode=arguments.decode, advance=bar.advance)
    else:
        report = requested
    return print_check(report, arguments.submission, as_json=arguments.json)


def _hidden(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Hidden, argv, "mirror submission hidden", examples=_HIDDEN_EXAMPLES)

    from mirror.dataset import open as open_dataset
    from mirror.evaluation.scorers import load_scorer
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views import plan_views
    from mirror.synth import read_recorded_seed, write_hidden_truth

    preset, seed = read_recorded_seed(arguments.recordings, "--recordings")
    dataset = open_dataset(arguments.dataset)
    plan = plan_views(dataset, load_protocol(arguments.protocol), arguments.split)
    if load_scorer(plan.protocol.task).hidden_use(plan) == "unused":
        raise UsageError(
            f"protocol {plan.protocol.name} is scored against recorded images and uses no hidden truth",
            place="--protocol", expected="a protocol of moved cameras or edited vehicles, such as lane-shift",
        )  # fmt: skip
    with progress_bar(quiet=arguments.json) as bar:
        bar.start("images", len(plan.views))
        count = write_hidden_truth(dataset, plan, preset, seed, arguments.out, bar.advance)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), "pictures": count}))
    else:
        print(f"{count} true images in {arguments.out}: do not publish them")
    return ExitCode.DONE


def requested_views(
    files: UntrustedFiles, protocol: str | None, split: str | None
) -> tuple[str, str] | SubmissionCheck:
    """Return the protocol and split of a submission, or the problems of a submission that does not state them.

    Args:
        files: of the submission.
        protocol: replaces that of the manifest.
        split: replaces that of the manifest.
    """
    from mirror.evaluation.submission.check import report_unreadable_manifest
    from mirror.evaluation.submission.manifest import read_protocol_and_split
    from mirror.evaluation.submission.untrusted import UntrustedError

    try:
        return read_protocol_and_split(files, protocol, split)
    except UntrustedError as error:
        return report_unreadable_manifest(files, error)


def load_requested_protocol(protocol: str, given: str | None) -> Protocol:
    """Load the protocol of a submission.

    Args:
        protocol: as `requested_views` returned it.
        given: value of --protocol; None: the submission's manifest names the protocol.

    Raises:
        UsageError: no protocol has that name, or its file cannot be read.
        SchemaError: its file is invalid.
    """
    from mirror.protocols.document import load_protocol, protocol_names

    # A submission is untrusted: its manifest names no file.
    if given is None and protocol not in protocol_names():
        raise UsageError(
            f"the submission follows protocol {protocol!r}, which does not come with the toolkit",
            expected=f"one of {', '.join(protocol_names())}, or the file of that protocol",
            remedy="give the file with --protocol FILE.toml",
        )
    return load_protocol(protocol)


def print_check(report: SubmissionCheck, submission: Path, *, as_json: bool) -> ExitCode:
    """Print the report of a check, and return its exit code."""
    if as_json:
        print(json.dumps(plain_report(report)))
    else:
        print_report(report, submission)
    return ExitCode.FINDINGS if report.problems else ExitCode.DONE


def plain_report(report: SubmissionCheck) -> dict[str, object]:
    """Return the report of a check for ``--json``."""
    return {
        "expected": report.expected,
        "present": report.present,
        "counts": report.counts(),
        "problems": [asdict(problem) for problem in report.problems],
        "not_checked": report.not_checked,
    }


def print_report(report: SubmissionCheck, submission: Path) -> None:
    """Print the report of a check for people: the first problems of each kind, and how many more there are."""
    from itertools import groupby

    for kind, group in groupby(report.problems, key=lambda problem: problem.kind):
        problems = list(group)
        print(f"{kind}: {len(problems)}")
        for problem in problems[:_LISTED_PROBLEMS]:
            print(f"  {_printable(problem.path)}: {_printable(problem.message)}")
        if len(problems) > _LISTED_PROBLEMS:
            print(f"  ... and {len(problems) - _LISTED_PROBLEMS} more; --json lists all")
    count = len(report.problems)
    verdict = count_of(count, "problem") if count else "no problems"
    # Without a manifest the expected files are unknown.
    presence = f"{report.present} of {report.expected} expected files are present; " if report.expected else ""
    print(f"{submission}: {presence}{verdict}")
    for subject in report.not_checked:
        print(f"not checked: {subject}")


def _printable(text: str) -> str:
    """Escape control characters: file names of others must not control the terminal."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text[:300])
