"""``mirror annotate DATASET --annotator NAME``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from mirror.command_line import help_text, parse_arguments, parse_settings
from mirror.devices import choose_device
from mirror.errors import ExitCode
from mirror.executors.arguments import ExecutorArguments

if TYPE_CHECKING:
    from mirror.annotation.run import AnnotationReport

_MOST_SHOWN: Final = 5
_EXAMPLES: Final = (
    "mirror annotate demo/dataset --annotator file --set path=results.json",
    "mirror annotate demo/dataset --annotator subprocess --set command='python detect.py' --set limit_s=20",
)


@dataclass(frozen=True)
class Arguments:
    """Find the road users in all frames of a dataset, and write a layer of boxes for each traversal.

    `mirror annotate train` trains an annotator, `mirror annotate track` makes tracks of a layer of boxes, `mirror
    annotate masks` writes masks of its road users, `mirror annotate export` writes it as a file, and `mirror annotate
    describe` writes captions. Layers lie side by side and are never replaced. Finished frames are kept when the run is
    interrupted or a frame fails: the same command continues there.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    annotator: Annotated[str, help_text(metavar="NAME|FILE.py:OBJECT")]
    """An installed annotator (entry points mirror.annotators): file reads results of the nuScenes format, subprocess
    runs a program of yours."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=VALUE")] = ()
    """A setting of the annotator, such as path=results.json."""
    source: Annotated[str | None, help_text(default="the annotator's name", metavar="NAME")] = None
    """Source name of the layers."""
    version: Annotated[str | None, help_text(default="the annotator's version", metavar="NAME")] = None
    """Version of the layers."""
    scene: Annotated[str | None, help_text(default="all", metavar="ID")] = None
    """Annotate this scene only."""
    skip_failed: bool = False
    """Write the layer of a traversal although frames failed; they have no boxes then."""
    device: Annotated[str, help_text(metavar="auto|cpu|cuda[:N]")] = "auto"
    """Device that runs networks. auto: a GPU that torch can use, else the CPU. The first line says which."""
    executor: tyro.conf.OmitArgPrefixes[ExecutorArguments] = field(default_factory=ExecutorArguments)
    workers: Annotated[int | None, help_text(default="one a core, or as many as a cluster has room for")] = None
    """Number of workers of --executor processes or ray; each has the annotator, and takes a traversal at a time."""
    json: bool = False
    """Print JSON."""


def run(argv: Sequence[str]) -> int:
    """Find the road users in all frames of a dataset."""
    arguments = parse_arguments(Arguments, argv, "mirror annotate", examples=_EXAMPLES)

    from mirror.annotation.protocol import TrainableAnnotator, takes_device
    from mirror.annotation.registry import AnnotatorChoice, installed_annotator, open_annotator

    executor = arguments.executor.choose("serial", arguments.workers)
    installed = installed_annotator(arguments.annotator)
    device = choose_device(arguments.device, f"annotator {arguments.annotator}", takes_device=takes_device(installed))
    if not arguments.json:
        print(device, flush=True)

    from mirror.annotation.run import annotate
    from mirror.dataset.writing import open_to_write
    from mirror.progress import progress_bar

    dataset = open_to_write(arguments.dataset)
    if arguments.scene is not None:
        dataset = dataset.where(scene=arguments.scene)
    settings = parse_settings(arguments.set)
    annotator = open_annotator(arguments.annotator, installed, dataset, settings, device.name)
    try:
        with progress_bar(quiet=arguments.json) as bar:
            report = annotate(
                dataset,
                annotator,
                source=arguments.source,
                version=arguments.version,
                skip_failed=arguments.skip_failed,
                progress=bar,
                executor=None if executor.kind == "serial" else executor,
                choice=AnnotatorChoice(arguments.annotator, settings, device.name),
            )
    finally:
        annotator.close()
    if arguments.json:
        print(json.dumps({"dataset": str(arguments.dataset), **asdict(report)}))
    else:
        _print(report, arguments, trainable=isinstance(installed, TrainableAnnotator))
    return ExitCode.PARTLY_DONE if report.failed or report.broken else ExitCode.DONE


def _print(report: AnnotationReport, arguments: Arguments, *, trainable: bool) -> None:
    from mirror.annotation.familiarity import describe_training_data

    print(
        f"layer boxes/{report.layer}: {len(report.written)} traversals written, {len(report.kept)} kept; "
        f"{report.boxes} boxes in {report.frames + report.resumed} frames ({report.resumed} from an earlier run)"
    )
    if report.trained_on is not None and report.written:
        frames = report.frames + report.resumed
        print(describe_training_data(arguments.annotator, report.trained_on, report.unfamiliar, frames))
        if report.unfamiliar and trainable:
            print(f"train on boxes of your own: mirror annotate train DATASET --annotator {arguments.annotator}")
    for name, reason in report.broken.items():
        print(f"{name}: {reason}; the same command tries it again")
    if report.failed:
        print(
            f"{len(report.failed)} frames failed; traversals without a layer: {', '.join(report.incomplete) or 'none'}"
        )
        for failed in report.failed[:_MOST_SHOWN]:
            print(f"  {failed.traversal_id}, frame {failed.frame_index}: {failed.reason}")
        if report.incomplete:
            print("run the same command again for the failed frames, or write the layers without them: --skip-failed")
    elif report.written:
        print(f"next: mirror annotate track {arguments.dataset} --boxes {report.layer}")
