"""``mirror check DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.counting import count_of
from mirror.errors import UsageError

if TYPE_CHECKING:
    from mirror.integrity import CheckReport

_LISTED_FILES = 5
_EXAMPLES = ("mirror check demo/dataset", "mirror check demo/dataset --quick --skip POS --strict")


@dataclass(frozen=True)
class Arguments:
    """Check a dataset against the integrity rules of docs/rules.md. The dataset is not changed.

    Exit codes: 0 no errors, 1 errors (with --strict also warnings), 2 could not run.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset; of a URL, documents and tables are copied to this machine first."""
    rule: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="RULE")] = ()
    """Run only this rule (POS003) or group (POS), also if --quick would leave it out."""
    skip: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="RULE")] = ()
    """Leave out this rule or group."""
    quick: bool = False
    """Read tables and documents only, not the sizes and the first and last bytes of files. Excludes --full."""
    full: bool = False
    """Read every byte: hash all files and decode all images. Excludes --quick."""
    strict: bool = False
    """Exit with code 1 for warnings too."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror check", examples=_EXAMPLES)
    if arguments.quick and arguments.full:
        raise UsageError("--quick and --full exclude each other", expected="one of them, or neither")

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
        "unread": [error.to_dict() for error in report.unreadable],
        "exit_code": int(report.exit_code(strict=arguments.strict)),
    }


def _print(report: CheckReport, arguments: Arguments) -> None:
    from itertools import groupby

    from rich.text import Text

    from mirror.cli.output import plain_console
    from mirror.integrity.registry import rules

    console = plain_console(soft_wrap=True)
    colours = {"error": "red", "warning": "yellow", "info": "blue"}
    for rule, group in groupby(report.findings, key=lambda pair: pair[0]):
        colour = colours[rule.severity]
        console.print(Text(f"{rule.rule_id} {rule.severity}", style=colour), rule.title)
        findings = [finding for _, finding in group]
        for finding in findings[:_LISTED_FILES]:
            place = f": {finding.place}" if finding.place else ""
            more = f" ({finding.count} in all)" if finding.count > 1 else ""
            console.print(f"  {finding.file}{place}: {finding.message}{more}")
        if len(findings) > _LISTED_FILES:
            console.print(f"  ... and in {len(findings) - _LISTED_FILES} more files; --json lists all")
        console.print(f"  remedy: {rule.remedy}")
    for error in report.unreadable:
        console.print(Text("could not read", style="red"), str(error))
    counts = report.counts()
    parts = [count_of(counts[name], name) for name in ("error", "warning", "info")]
    run, known = len(report.rules), len(rules())
    ran = f"{run} of {known} rules" if run < known else f"{known} rules"
    chosen = arguments.full or arguments.rule or arguments.skip
    console.print(f"{ran}{'' if chosen else ' (--full runs all)'}: {', '.join(parts)}: {arguments.dataset}")
