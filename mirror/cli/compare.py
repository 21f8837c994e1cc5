"""``mirror compare RESULT RESULT ...``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode

_UNBOUNDED = 1000
_EXAMPLES = (
    "mirror compare demo/results/nearest_frame demo/results/mean_color",
    "mirror compare demo/block/results/reconstructed demo/block/results/nearest_frame --json",
)


@dataclass(frozen=True)
class Arguments:
    """Compare results with the first one: differences with confidence intervals and p-values over paired images.

    The bootstrap resamples blocks of consecutive frames. The p-values are not corrected for multiple comparisons.
    """

    results: Annotated[tyro.conf.Positional[tuple[Path, ...]], help_text(default="none", metavar="RESULT...")]
    """Two or more result.json files, or their folders, of one protocol, split and dataset."""
    json: bool = False
    """Print the comparison as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror compare", examples=_EXAMPLES)

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
    window_width = console.width
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
                f"{row.metric} (ranks)" if row.ranks else row.metric,
                *(_number(value) for value in (row.first, row.other)),
                "" if row.difference is None else f"{row.difference:+.4f}",
                interval,
                _number(row.p_value),
                str(row.n or ""),
                better or (f"[{reasons.setdefault(row.reason, len(reasons) + 1)}]" if row.reason else ""),
            )
        # Numbers are not truncated: a narrow window wraps the line, and a pipe has no width.
        wide = console.options.update(width=_UNBOUNDED, max_width=_UNBOUNDED)
        console.width = max(window_width, Measurement.get(console, wide, table).maximum)
        console.print(table)
        for reason, number in reasons.items():
            console.print(f"[{number}] {reason}", soft_wrap=True)
    return ExitCode.DONE


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"
