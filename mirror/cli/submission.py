"""``mirror submission new DATASET``, ``check SUBMISSION`` and ``hidden DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from mirror.command_line import Subcommand, parse_arguments, run_subcommand
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from mirror.evaluation.submission.check import CheckReport
    from mirror.evaluation.submission.untrusted import UntrustedFiles

_SHOWN = 8


@dataclass(frozen=True)
class New:
    """Write the template of a submission: every expected file with pose, lens, size and mask, and a manifest."""

    dataset: tyro.conf.Positional[str]
    """The dataset's folder or URL."""
    protocol: str
    """Name of the protocol, or the path of a protocol's .toml."""
    split: str
    """Name of the split."""
    out: Path
    """A new or an empty folder, or one in which the same was begun."""
    blind: bool = False
    """Say nothing of where the recorded pictures lie: for whoever does not have the dataset."""
    json: bool = False
    """Print what was written as JSON."""


@dataclass(frozen=True)
class Check:
    """Hold a submission against what is expected of it; all problems are listed at once, nothing is scored.

    Exit codes: 0 nothing is wrong, 1 something is, 2 could not run.
    """

    submission: tyro.conf.Positional[Path]
    """Its folder, or a zip of it."""
    truth: str
    """The dataset's folder or URL."""
    protocol: str | None = None
    """Name of the protocol, or the path of its .toml. Default: what the manifest says."""
    split: str | None = None
    """Name of the split. Default: what the manifest says."""
    decode: bool = False
    """Decode every image too, which takes minutes where the rest takes seconds."""
    json: bool = False
    """Print the report as JSON."""


@dataclass(frozen=True)
class Hidden:
    """Render the true pictures of moved cameras of a synthetic street: what an organiser gives to evaluate --hidden."""

    dataset: tyro.conf.Positional[str]
    """The dataset's folder or URL, of recordings that `mirror synth` wrote."""
    split: str
    """Name of the split."""
    preset: str
    """That `mirror synth` was run with."""
    out: Path
    """A new or an empty folder, or one in which the same was begun. Keep it to yourself."""
    seed: int = 0
    """That `mirror synth` was run with."""
    protocol: str = "lane-shift"
    """Name of the protocol, or the path of a protocol's .toml."""
    json: bool = False
    """Print what was written as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "new": Subcommand("write the template of a submission", _new),
        "check": Subcommand("check the files of a submission, without scoring them", _check),
        "hidden": Subcommand("render the hidden truth of a synthetic street, for organisers", _hidden),
    }
    return run_subcommand(argv, "mirror submission", subcommands)


def _new(argv: Sequence[str]) -> int:
    arguments = parse_arguments(New, argv, "mirror submission new")

    import mirror
    from mirror.evaluation.submission.template import write_template
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.truth.source import GroundTruth
    from mirror.protocols.views import plan_views

    dataset, protocol = mirror.open(arguments.dataset), load_protocol(arguments.protocol)
    plan = plan_views(dataset, protocol, arguments.split)
    truth = GroundTruth(dataset, protocol, plan.layers)
    with progress_bar(quiet=arguments.json) as bar:
        bar.start("views", len(plan.views))
        count = write_template(arguments.out, plan, truth, blind=arguments.blind, advance=bar.advance)
    if arguments.json:
        said = {"out": str(arguments.out), "expected": count, "groups_without_views": plan.empty_groups}
        print(json.dumps({**said, "protocol_hash": protocol.hash, "plan_hash": plan.hash}))
    else:
        print(f"{count} files are expected: {arguments.out}/views.json lists them, README.md says how")
        for group in plan.empty_groups:
            print(f"group {group} has no views in split {arguments.split}")
    return ExitCode.DONE


def _check(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Check, argv, "mirror submission check")

    import mirror
    from mirror.evaluation.submission.check import check_submission
    from mirror.evaluation.submission.untrusted import open_untrusted
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views import plan_views

    files = open_untrusted(arguments.submission)
    asked = asked_or_problems(files, arguments.protocol, arguments.split)
    if isinstance(asked, tuple):
        protocol, split = asked
        plan = plan_views(mirror.open(arguments.truth), load_protocol(protocol), split)
        with progress_bar(quiet=arguments.json) as bar:
            bar.start("files", len(plan.views))
            report = check_submission(files, plan, decode=arguments.decode, advance=bar.advance)
    else:
        report = asked
    return say_report(report, arguments.submission, as_json=arguments.json)


def _hidden(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Hidden, argv, "mirror submission hidden")

    import mirror
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views import plan_views
    from mirror.synth.hidden_truth import write_hidden_truth

    dataset = mirror.open(arguments.dataset)
    plan = plan_views(dataset, load_protocol(arguments.protocol), arguments.split)
    with progress_bar(quiet=arguments.json) as bar:
        bar.start("pictures", len(plan.views))
        count = write_hidden_truth(dataset, plan, arguments.preset, arguments.seed, arguments.out, bar.advance)
    said = {"out": str(arguments.out), "pictures": count}
    print(json.dumps(said) if arguments.json else f"{count} true pictures in {arguments.out}: keep them to yourself")
    return ExitCode.DONE


def asked_or_problems(files: UntrustedFiles, protocol: str | None, split: str | None) -> tuple[str, str] | CheckReport:
    """Protocol and split of a submission, or what is wrong with one that does not say them."""
    from mirror.evaluation.submission.check import report_unreadable_manifest
    from mirror.evaluation.submission.manifest import read_protocol_and_split
    from mirror.evaluation.submission.untrusted import UntrustedError

    try:
        return read_protocol_and_split(files, protocol, split)
    except UntrustedError as error:
        return report_unreadable_manifest(files, error)


def say_report(report: CheckReport, submission: Path, *, as_json: bool) -> ExitCode:
    """Print a check's report, and give the exit code that it means."""
    if as_json:
        print(json.dumps(plain_report(report)))
    else:
        print_report(report, submission)
    return ExitCode.FINDINGS if report.problems else ExitCode.DONE


def plain_report(report: CheckReport) -> dict[str, object]:
    """A check's report for ``--json``."""
    return {
        "expected": report.expected,
        "present": report.present,
        "counts": report.counts(),
        "problems": [asdict(problem) for problem in report.problems],
        "not_checked": report.not_checked,
    }


def print_report(report: CheckReport, submission: Path) -> None:
    """A check's report for people: some problems of each kind, and how many more."""
    from itertools import groupby

    for kind, own in groupby(report.problems, key=lambda problem: problem.kind):
        problems = list(own)
        print(f"{kind}: {len(problems)}")
        for problem in problems[:_SHOWN]:
            print(f"  {_printable(problem.path)}: {_printable(problem.message)}")
        if len(problems) > _SHOWN:
            print(f"  ... and {len(problems) - _SHOWN} more; --json lists all")
    count = len(report.problems)
    verdict = f"{count} problem{'s' * (count != 1)}" if count else "nothing is wrong"
    # Without a manifest nobody knows what is expected.
    there = f"{report.present} of {report.expected} expected files are there; " if report.expected else ""
    print(f"{submission}: {there}{verdict}")
    for what in report.not_checked:
        print(f"not checked: {what}")


def _printable(text: str) -> str:
    """File names of others must not steer the terminal."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text[:300])
