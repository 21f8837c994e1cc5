"""``mirror compare RESULT RESULT ...``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode

_UNBOUNDED = 1000


@dataclass(frozen=True)
class Arguments:
    """Put results side by side: differences from the first, with intervals and p-values of paired pictures.

    Blocks of consecutive frames are resampled, not single pictures; many comparisons at once are not corrected for.
    """

    results: tyro.conf.Positional[tuple[Path, ...]]
    """result.json files or their folders, two or more, of one protocol, split and dataset."""
    json: bool = False
    """Print the comparison as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror compare")

    from mirror.evaluation.compare import compare

    first, others = compare(arguments.results)
    if arguments.json:
        plain = {"first": first.submission.method.name, "others": [asdict(other) for other in others]}
        print(json.dumps({"protocol": first.protocol.name, "split": first.dataset.split, **plain}))
        return ExitCode.DONE

    from rich.measure import Measurement
    from rich.table import Table

    from mirror.cli.output import plain_console

    console = plain_console()
    window = console.width
    for other in others:
        title = f"{other.name} against {first.submission.method.name}"
        table = Table(title=title, title_justify="left", box=None, pad_edge=False)
        for name in ("group", "metric"):
            table.add_column(name, no_wrap=True)
        for name in (first.submission.method.name, other.name, "difference", "interval", "p", "n", "better"):
            table.add_column(name, justify="right", no_wrap=True)
        reasons: dict[str, int] = {}
        for row in other.rows:
            interval = "" if row.low is None or row.high is None else f"{row.low:+.4f} to {row.high:+.4f}"
            better = {"first": first.submission.method.name, "other": other.name}.get(row.better or "", "")
            table.add_row(
                row.group,
                row.metric,
                *(_number(value) for value in (row.first, row.other)),
                "" if row.difference is None else f"{row.difference:+.4f}",
                interval,
                _number(row.p_value),
                str(row.n or ""),
                better or (f"[{reasons.setdefault(row.reason, len(reasons) + 1)}]" if row.reason else ""),
            )
        # A figure is never cut: a narrow window wraps the line, and a pipe has no edge.
        unbounded = console.options.update(width=_UNBOUNDED, max_width=_UNBOUNDED)
        console.width = max(window, Measurement.get(console, unbounded, table).maximum)
        console.print(table)
        for reason, number in reasons.items():
            console.print(f"[{number}] {reason}", soft_wrap=True)
    return ExitCode.DONE


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"
