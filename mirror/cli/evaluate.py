"""``mirror evaluate DATASET SUBMISSION --protocol NAME --split NAME`` and ``mirror evaluate RUN --protocol safety``."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.command_line import help_text, local_path, parse_arguments
from mirror.devices import resolve_device
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.evaluation.result import GroupFigure, Result
    from mirror.evaluation.run import Evaluation

_EXAMPLES = (
    "mirror evaluate demo/dataset demo/submissions/mean_color --report --baseline demo/results/nearest_frame",
    "mirror evaluate rollouts --protocol safety --out scores --json",
)
_RENAMED = {"--truth": "DATASET"}


@dataclass(frozen=True)
class Arguments:
    """Score a submission by a protocol. --out receives result.json and a Parquet table with the scores of every image.

    With one folder, rollouts of `mirror simulate` are scored: by the protocol safety, and without a dataset.

    A run after an interruption reuses the scores that exist. Exit codes: 0 scored, 1 the submission has problems (all
    are listed, nothing is scored), 2 could not run, or a required metric is unavailable.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset: it has the truth. For rollouts: a rollout, or a folder of them."""
    submission: Annotated[tyro.conf.Positional[Path | None], help_text(default="none: rollouts")] = None
    """Folder of the submission, or a zip file of it."""
    protocol: Annotated[str | None, help_text(default="that of the manifest", metavar="NAME")] = None
    """Name of a protocol, or path of its .toml file."""
    split: Annotated[str | None, help_text(default="that of the manifest", metavar="NAME")] = None
    """Name of the split."""
    out: Annotated[Path | None, help_text(default="SUBMISSION-results, beside the submission", metavar="FOLDER")] = None
    """Folder for the results. For rollouts: RUN-results, beside the rollouts."""
    report: bool = False
    """Also write report.html: figures, and the worst, median and best renders beside truth and error. For rollouts:
    figures, and the worst rollouts from above."""
    baseline: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction, help_text(metavar="RESULTS")] = ()
    """Show another evaluation of the same views in the report, such as that of a floor. For rollouts: of another policy
    on the same drives, with the paired differences."""
    require: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="METRIC")] = ()
    """Fail if this metric is unavailable, such as lpips. Others are listed as unavailable and left out."""
    stand_ins: bool = False
    """If LPIPS is unavailable, compute ST-LPIPS under its own name. It is another metric, and slow."""
    weights: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=FILE")] = ()
    """Weights of a network; docs/weights.md lists the names."""
    download_weights: bool = False
    """Allow missing weights to be downloaded."""
    hidden: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Folder of the organiser's hidden truth, for protocols with poses that were not recorded."""
    extractor: Annotated[str | None, help_text(default="diff-grabcut")] = None
    """Extractor of edited regions: diff-grabcut, file:FOLDER or onnx-sam:FOLDER."""
    measure: Annotated[str | None, help_text(default="none", metavar="METHOD=MODEL")] = None
    """Measure the rendering speed of a method, an installed one (entry points mirror.methods) or FILE.py:OBJECT, with
    this model folder."""
    secret: Annotated[Path | None, help_text(default="none", metavar="FILE")] = None
    """For rollouts of a suite with a secret: the organiser's file of it."""
    features: Annotated[Path | None, help_text(default="in --out", metavar="FOLDER")] = None
    """Folder of cached features of true images, which evaluations may share."""
    workers: int = field(default_factory=lambda: min(os.cpu_count() or 1, 2))
    """Greatest number of processes; a second one starts only where it saves more than its own start."""
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "cpu"
    """Where networks such as LPIPS and Inception run. Scores for a board are those of the CPU; others say so."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror evaluate", examples=_EXAMPLES, renamed=_RENAMED)

    from mirror.cli.submission import load_requested_protocol, print_check, requested_views
    from mirror.evaluation.run import EvaluationOptions, evaluate, read_result
    from mirror.evaluation.submission.untrusted import open_untrusted
    from mirror.progress import progress_bar
    from mirror.weights.resolve import WeightResolver

    if arguments.submission is None:
        return _evaluate_rollouts(arguments)
    if arguments.secret is not None:
        raise UsageError("a submission of renders", place="--secret", expected="rollouts of a suite")
    if arguments.baseline and not arguments.report:
        raise UsageError("--baseline is shown in the report", expected="--report beside it")
    device = resolve_device(arguments.device)
    if not arguments.json:
        print(device, flush=True)
    baselines = [read_result(path) for path in arguments.baseline]
    requested = requested_views(open_untrusted(arguments.submission), arguments.protocol, arguments.split)
    if not isinstance(requested, tuple):
        return print_check(requested, arguments.submission, as_json=arguments.json)
    protocol, split = requested
    # The path `.` has no name.
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
        device=device.name,
    )
    with progress_bar(quiet=arguments.json) as bar:
        evaluation = evaluate(
            submission,
            arguments.dataset,
            load_requested_protocol(protocol, arguments.protocol),
            split,
            out,
            options,
            bar,
        )
    if evaluation.result is None:
        return print_check(evaluation.check, submission, as_json=arguments.json)
    page = _report(evaluation, out, baselines) if arguments.report else None
    if arguments.json:
        places = {"out": str(out), "report": None if page is None else str(page), "result_hash": evaluation.result.hash}
        print(json.dumps({**places, "reused": evaluation.reused, "result": evaluation.result.model_dump(mode="json")}))
    else:
        _print(evaluation.result, out, page)
    return ExitCode.DONE


def _evaluate_rollouts(arguments: Arguments) -> ExitCode:
    from mirror.evaluation.rollouts import evaluate_rollouts
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.suite import read_secret

    folder = local_path(Path(arguments.dataset), "DATASET")
    unused = {
        "--split": arguments.split,
        "--require": arguments.require,
        "--stand-ins": arguments.stand_ins,
        "--weights": arguments.weights,
        "--hidden": arguments.hidden,
        "--extractor": arguments.extractor,
        "--measure": arguments.measure,
        "--features": arguments.features,
        "--device": arguments.device != Arguments.device,
    }
    named = next((option for option, value in unused.items() if value), None)
    if named is not None:
        raise UsageError(
            "there is no SUBMISSION, and rollouts have no such option", place=named, expected="DATASET and SUBMISSION"
        )
    if arguments.baseline and not arguments.report:
        raise UsageError("--baseline is shown in the report", expected="--report beside it")
    named_folder = folder if folder.name else folder.absolute()
    out = arguments.out or named_folder.with_name(f"{named_folder.name}-results")
    protocol = load_protocol(arguments.protocol or "safety")
    secret = None
    if protocol.suite is not None:
        secret = read_secret(arguments.secret, protocol.suite, protocol.name)
    elif arguments.secret is not None:
        raise UsageError(f"protocol {protocol.name} has no suite", place="--secret", expected="a suite with a secret")
    with progress_bar(quiet=arguments.json) as bar:
        evaluation = evaluate_rollouts(folder, protocol, out, bar, secret=secret)
    result, page = evaluation.result, out / "report.html" if arguments.report else None
    if page is not None:
        from mirror.evaluation.compare import compare
        from mirror.evaluation.rollout_report import write_rollout_report

        pairs = compare([out, *arguments.baseline])[1] if arguments.baseline else []
        write_rollout_report(evaluation, folder, page, pairs)
    if arguments.json:
        places = {"out": str(out), "report": None if page is None else str(page), "result_hash": result.hash}
        print(json.dumps({**places, "result": result.model_dump(mode="json")}))
    else:
        _print(result, out, page, "rollout")
    return ExitCode.DONE


def _weight_paths(pairs: Sequence[str]) -> Mapping[str, Path]:
    paths = dict(_pair(text, "--weights", "NAME=FILE") for text in pairs)
    for name, path in paths.items():
        if not path.is_file():
            raise UsageError("no such file", file=path, place=f"--weights {name}", expected="a file of weights")
    return paths


def _pair(text: str, option: str, expected: str) -> tuple[str, Path]:
    name, equals, path = text.partition("=")
    if not (name and equals and path):
        raise UsageError(f"{text!r}", place=option, expected=expected)
    return name, local_path(Path(path), option)


def _report(evaluation: Evaluation, out: Path, baselines: Sequence[Result]) -> Path:
    from mirror.evaluation.report import write_report

    page = out / "report.html"
    write_report(evaluation, page, baselines)
    return page


def _print(result: Result, out: Path, page: Path | None, scored: str = "image") -> None:
    from rich.table import Table

    from mirror.cli.output import plain_console

    console = plain_console()
    table = Table(title=f"{result.submission.method.name}: {result.protocol.name}, split {result.dataset.split}")
    for name in ("group", "metric"):
        table.add_column(name)
    for name in ("value", f"{100 * result.protocol.intervals.level:g} % interval", "n"):
        table.add_column(name, justify="right")
    reasons: dict[str, int] = {}
    column = None if result.protocol.ranking is None else result.protocol.ranking.column
    for figure in sorted(result.figures, key=lambda figure: (figure.group, figure.metric) != column):
        if figure.level == "group":
            value, interval, count = figure_words(figure)
            if figure.low is None and figure.interval_reason is not None:
                interval = f"[{reasons.setdefault(figure.interval_reason, len(reasons) + 1)}]"
            metric = f"{figure.metric} (ranks)" if (figure.group, figure.metric) == column else figure.metric
            table.add_row(figure.group, metric, value, interval, count)
    console.print(table)
    for reason, number in reasons.items():
        console.print(f"[{number}] no interval: {reason}", soft_wrap=True)
    for metric, remedy in result.unavailable.items():
        console.print(f"{metric}: unavailable: {remedy}", soft_wrap=True)
    for warning in result.warnings:
        console.print(f"note: {warning}", soft_wrap=True)
    files = f"{out / 'result.json'} has all figures, {out / 'images.parquet'} the scores of every {scored}"
    console.print(files, soft_wrap=True)
    if page is not None:
        console.print(f"report: {page}", soft_wrap=True)


def figure_words(figure: GroupFigure) -> tuple[str, str, str]:
    """Return the value, interval and count of a figure as text."""
    from mirror.metrics.catalogue import find_measure

    measure = find_measure(figure.metric)
    value = figure.reason or "none"
    if figure.value is not None:
        value = f"{measure.format_exactly(figure.value)} {measure.unit}".strip()
    interval = ""
    if figure.low is not None and figure.high is not None:
        interval = f"{measure.format_exactly(figure.low)} to {measure.format_exactly(figure.high)}"
    more = [f"{figure.n_inf} equal"] * bool(figure.n_inf) + [f"{figure.n_missing} missing"] * bool(figure.n_missing)
    return value, interval, f"{figure.n}" + (f" ({', '.join(more)})" if more else "")
