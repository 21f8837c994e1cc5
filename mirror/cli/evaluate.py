"""``mirror evaluate SUBMISSION --truth DATASET --protocol NAME --split NAME``."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.command_line import local_path, parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.evaluation.result import Figure, Result
    from mirror.evaluation.run import Evaluation


@dataclass(frozen=True)
class Arguments:
    """Score a submission by a protocol: result.json and a Parquet of every picture in --out, with --report a page.

    What an interrupted run scored is used again. Exit codes: 0 scored, 1 the submission has problems (all are listed,
    nothing is scored), 2 could not run, or a required metric cannot be had.
    """

    submission: tyro.conf.Positional[Path]
    """Its folder, or a zip of it."""
    truth: str
    """The dataset's folder or URL."""
    protocol: str | None = None
    """Name of the protocol, or the path of its .toml. Default: what the manifest says."""
    split: str | None = None
    """Name of the split. Default: what the manifest says."""
    out: Path | None = None
    """Folder for the results. Default: SUBMISSION-results beside the submission."""
    report: bool = False
    """Write report.html too: figures, and the worst, median and best renders beside truth and error."""
    require: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A metric that must be had, such as lpips; may be repeated. Default: what cannot be had is said, and left out."""
    stand_ins: bool = False
    """Where LPIPS cannot be had, compute ST-LPIPS under its own name: another metric, and slow."""
    weights: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """NAME=FILE of weights, as docs/weights.md names them; may be repeated."""
    download_weights: bool = False
    """Allow missing weights to be downloaded."""
    hidden: Path | None = None
    """Folder of an organiser's true pictures, for protocols whose poses nobody recorded."""
    extractor: str | None = None
    """Of edited regions: diff-grabcut (the default), file:FOLDER or onnx-sam:FOLDER."""
    measure: str | None = None
    """METHOD=FOLDER: an installed method (entry points mirror.methods) and its model, to measure the speed of."""
    features: Path | None = None
    """Folder of cached features of true pictures, shared between evaluations. Default: in --out."""
    workers: int = field(default_factory=lambda: min(os.cpu_count() or 1, 2))
    """Processes."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror evaluate")

    from mirror.cli.submission import asked_or_problems, say_report
    from mirror.evaluation.run import EvaluationOptions, evaluate
    from mirror.evaluation.submission.untrusted import open_untrusted
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.weights.resolve import WeightResolver

    asked = asked_or_problems(open_untrusted(arguments.submission), arguments.protocol, arguments.split)
    if not isinstance(asked, tuple):
        return say_report(asked, arguments.submission, as_json=arguments.json)
    protocol, split = asked
    # `.` has no name to put results beside.
    submission = arguments.submission if arguments.submission.name else arguments.submission.absolute()
    out = arguments.out or submission.with_name(f"{submission.stem}-results")
    options = EvaluationOptions(
        hidden=arguments.hidden,
        require=arguments.require,
        stand_ins=arguments.stand_ins,
        workers=arguments.workers,
        resolver=WeightResolver(_weight_paths(arguments.weights), arguments.download_weights),
        extractor=arguments.extractor,
        measured=None if arguments.measure is None else _pair(arguments.measure, "--measure", "METHOD=FOLDER"),
        features=arguments.features,
    )
    with progress_bar(quiet=arguments.json) as bar:
        done = evaluate(submission, arguments.truth, load_protocol(protocol), split, out, options, bar)
    if done.result is None:
        return say_report(done.check, submission, as_json=arguments.json)
    page = _report(done, out) if arguments.report else None
    if arguments.json:
        places = {"out": str(out), "report": None if page is None else str(page), "result_hash": done.result.hash}
        print(json.dumps({**places, "reused": done.reused, "result": done.result.model_dump(mode="json")}))
    else:
        _print(done.result, out, page)
    return ExitCode.DONE


def _weight_paths(given: Sequence[str]) -> Mapping[str, Path]:
    paths = dict(_pair(text, "--weights", "NAME=FILE") for text in given)
    for name, path in paths.items():
        if not path.is_file():
            raise UsageError("no such file", file=path, place=f"--weights {name}", expected="a file of weights")
    return paths


def _pair(text: str, option: str, expected: str) -> tuple[str, Path]:
    name, equals, path = text.partition("=")
    if not (name and equals and path):
        raise UsageError(f"{text!r}", place=option, expected=expected)
    return name, local_path(Path(path), option)


def _report(done: Evaluation, out: Path) -> Path:
    from mirror.evaluation.report import write_report

    page = out / "report.html"
    write_report(done, page)
    return page


def _print(result: Result, out: Path, page: Path | None) -> None:
    from rich.table import Table

    from mirror.cli.output import plain_console

    console = plain_console()
    table = Table(title=f"{result.submission.method.name}: {result.protocol.name}, split {result.dataset.split}")
    for name in ("group", "metric"):
        table.add_column(name)
    for name in ("value", f"{100 * result.protocol.intervals.level:g} % interval", "n"):
        table.add_column(name, justify="right")
    reasons: dict[str, int] = {}
    for figure in result.figures:
        if figure.level == "group":
            value, interval, count = figure_words(figure)
            if figure.low is None and figure.interval_reason is not None:
                interval = f"[{reasons.setdefault(figure.interval_reason, len(reasons) + 1)}]"
            table.add_row(figure.group, figure.metric, value, interval, count)
    console.print(table)
    for reason, number in reasons.items():
        console.print(f"[{number}] no interval: {reason}", soft_wrap=True)
    for metric, how in result.unavailable.items():
        console.print(f"{metric}: unavailable: {how}", soft_wrap=True)
    for warning in result.warnings:
        console.print(f"note: {warning}", soft_wrap=True)
    console.print(f"{out / 'result.json'} has all figures, {out / 'images.parquet'} every picture", soft_wrap=True)
    if page is not None:
        console.print(f"report: {page}", soft_wrap=True)


def figure_words(figure: Figure) -> tuple[str, str, str]:
    """Value, interval and count of a figure in words."""
    digits = 2 if figure.unit == "dB" else 4
    value = f"{figure.value:.{digits}f} {figure.unit}".strip() if figure.value is not None else figure.reason or "none"
    interval = ""
    if figure.low is not None and figure.high is not None:
        interval = f"{figure.low:.{digits}f} to {figure.high:.{digits}f}"
    more = [f"{figure.n_inf} equal"] * bool(figure.n_inf) + [f"{figure.n_missing} missing"] * bool(figure.n_missing)
    return value, interval, f"{figure.n}" + (f" ({', '.join(more)})" if more else "")
