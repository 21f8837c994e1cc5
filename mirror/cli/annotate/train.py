"""``mirror annotate train``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import help_text, parse_arguments, parse_settings
from mirror.errors import ExitCode, UsageError

_CORE_MINUTES: Final = 3.0
_EXAMPLES: Final = (
    "mirror annotate train demo/dataset --annotator petr-tiny --minutes 3 --out detector",
    "mirror annotate train streets/1 streets/2 --annotator petr-tiny --steps 2000 --threads 1 --out detector",
)


@dataclass(frozen=True)
class TrainArguments:
    """Train an annotator on the boxes of datasets.

    Ctrl-C leaves a checkpoint, and the same command continues from it. A finished model is reported and not changed.
    """

    datasets: Annotated[tyro.conf.Positional[tuple[str, ...]], help_text(default="none", metavar="DATASET")]
    """Folders or URLs of one or more datasets with boxes."""
    annotator: Annotated[str, help_text(metavar="NAME")]
    """An installed annotator that can be trained (entry points mirror.annotators), such as petr-tiny."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """Folder of the run: a new one, or that of an interrupted run with the same options."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes that is learned."""
    minutes: Annotated[float | None, help_text(default=f"{_CORE_MINUTES:g}, unless --steps is given")] = None
    """Processor time of training in minutes, summed over threads. Excludes --steps."""
    steps: Annotated[int | None, help_text(default="none")] = None
    """Number of steps. Repeats exactly with the same --threads. Excludes --minutes."""
    split: Annotated[str | None, help_text(default="all traversals", metavar="NAME")] = None
    """Train on the training traversals of this split alone."""
    seed: int = 0
    """Seed of all random choices."""
    threads: int = 1
    """Number of threads."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=VALUE")] = ()
    """A setting of the training, such as learning_rate=0.0005; run.json has all."""
    json: bool = False
    """Print JSON."""


def run(argv: Sequence[str]) -> int:
    """Train an annotator."""
    arguments = parse_arguments(TrainArguments, argv, "mirror annotate train", examples=_EXAMPLES)
    for name, number in (
        ("--minutes", arguments.minutes),
        ("--steps", arguments.steps),
        ("--threads", arguments.threads),
    ):
        if number is not None and not number > 0:
            raise UsageError(f"{number:g}", place=name, expected="more than 0")
    if arguments.seed < 0:
        raise UsageError(f"{arguments.seed}", place="--seed", expected="0 or more")
    if arguments.minutes is not None and arguments.steps is not None:
        raise UsageError("--minutes and --steps exclude each other", expected="one of them, or neither")
    if not arguments.datasets:
        raise UsageError("no dataset", place="DATASETS", expected="one or more datasets with boxes")

    from mirror.annotation.protocol import TrainableAnnotator, TrainingTask
    from mirror.annotation.registry import annotator_names, installed_annotator

    annotator = installed_annotator(arguments.annotator)
    if not isinstance(annotator, TrainableAnnotator):
        names = ", ".join(annotator_names())
        raise UsageError(
            f"annotator {arguments.annotator!r} cannot be trained", place="--annotator",
            expected=f"one that has a training, of {names}",
        )  # fmt: skip

    from mirror.annotation.box_layer import choose_box_layer
    from mirror.dataset import open as open_dataset
    from mirror.progress import progress_bar

    views = []
    for path in arguments.datasets:
        dataset = open_dataset(path)
        if arguments.split is not None:
            dataset = dataset.where(split=arguments.split, role="train")
        views.append(dataset.with_layers(boxes=choose_box_layer(dataset, arguments.boxes)))
    minutes = _CORE_MINUTES if arguments.minutes is None and arguments.steps is None else arguments.minutes
    task = TrainingTask(arguments.steps, minutes, arguments.seed, arguments.threads, parse_settings(arguments.set))
    with progress_bar(quiet=arguments.json) as bar:
        report = annotator.train(views, task, arguments.out, bar)
    if arguments.json:
        print(json.dumps(asdict(report)))
        return ExitCode.DONE
    print(
        f"{report.steps} steps on {report.frames} frames with {report.boxes} boxes, {report.core_s / 60.0:.1f} "
        f"core-minutes, {report.wall_s / 60.0:.1f} minutes; loss {report.loss:.3f}"
    )
    print(f"model: {report.model}, {report.model_bytes / 1e6:.2f} MB, sha256 {report.sha256}")
    print(f"next: mirror annotate DATASET --annotator {arguments.annotator} --set weights={report.model}")
    return ExitCode.DONE
