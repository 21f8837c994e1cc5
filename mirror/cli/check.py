"""``mirror check DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import UsageError

if TYPE_CHECKING:
    from mirror.integrity import CheckReport

_SHOWN = 5


@dataclass(frozen=True)
class Arguments:
    """Hold a dataset against the integrity rules of docs/rules.md. Nothing is written.

    Exit codes: 0 no errors, 1 errors (with --strict warnings too), 2 could not run.
    """

    dataset: tyro.conf.Positional[Path]
    """The dataset's folder."""
    rule: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Run only this rule (POS003) or group (POS), whatever it reads; may be repeated."""
    skip: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Leave out this rule or group; may be repeated."""
    quick: bool = False
    """Read tables and documents only. Default: sizes and ends of files too."""
    full: bool = False
    """Read every byte: hash all files, decode all pictures."""
    strict: bool = False
    """Warnings make exit code 1 as well."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror check")
    if arguments.quick and arguments.full:
        raise UsageError("--quick and --full at once", expected="one of them, or neither")

    from mirror.integrity import Cost, check
    from mirror.progress import progress_bar

    cost = Cost.TABLES if arguments.quick else Cost.IMAGES if arguments.full else Cost.FILES
    with progress_bar(quiet=arguments.json) as bar:
        report = check(
            arguments.dataset,
            only=arguments.rule,
            skip=arguments.skip,
            cost=cost,
            start=lambda scenes: bar.start("scenes", scenes),
            advance=bar.advance,
        )
    if arguments.json:
        print(json.dumps(_plain(report, arguments)))
    else:
        _print(report, arguments)
    return report.exit_code(strict=arguments.strict)


def _plain(report: CheckReport, arguments: Arguments) -> dict[str, object]:
    return {
        "dataset": str(arguments.dataset),
        "rules": [rule.rule_id for rule in report.rules],
        "counts": report.counts(),
        "findings": [
            {
                "rule": rule.rule_id,
                "severity": rule.severity,
                "file": finding.file,
                "place": finding.place,
                "message": finding.message,
                "count": finding.count,
                "remedy": rule.remedy,
            }
            for rule, finding in report.findings
        ],
        "unread": [error.to_dict() for error in report.unread],
        "exit_code": int(report.exit_code(strict=arguments.strict)),
    }


def _print(report: CheckReport, arguments: Arguments) -> None:
    from itertools import groupby

    from rich.text import Text

    from mirror.cli.output import plain_console

    console = plain_console(soft_wrap=True)
    colours = {"error": "red", "warning": "yellow", "info": "blue"}
    for rule, own in groupby(report.findings, key=lambda hit: hit[0]):
        colour = colours[rule.severity]
        console.print(Text(f"{rule.rule_id} {rule.severity}", style=colour), rule.title)
        findings = [finding for _, finding in own]
        for finding in findings[:_SHOWN]:
            place = f": {finding.place}" if finding.place else ""
            more = f" ({finding.count} in all)" if finding.count > 1 else ""
            console.print(f"  {finding.file}{place}: {finding.message}{more}")
        if len(findings) > _SHOWN:
            console.print(f"  ... and in {len(findings) - _SHOWN} more files; --json lists all")
        console.print(f"  remedy: {rule.remedy}")
    for error in report.unread:
        console.print(Text("could not read", style="red"), str(error))
    counts = report.counts()
    parts = [f"{counts[name]} {name}{'s' * (counts[name] != 1)}" for name in ("error", "warning", "info")]
    console.print(f"{len(report.rules)} rule{'s' * (len(report.rules) != 1)}: {', '.join(parts)}: {arguments.dataset}")
