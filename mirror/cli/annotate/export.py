"""``mirror annotate export``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode

_EXAMPLES: Final = ("mirror annotate export demo/dataset --boxes synth@0.1.0 --out review.json",)


@dataclass(frozen=True)
class ExportArguments:
    """Write a layer of boxes as results of the nuScenes detection task (JSON), for review in another tool.

    `mirror annotate DATASET --annotator file --set path=FILE` imports what comes back as a layer of its own.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    out: Annotated[Path, help_text(metavar="FILE")]
    """The file; it is replaced if it exists."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes."""
    json: bool = False
    """Print JSON."""


def run(argv: Sequence[str]) -> int:
    """Write a layer of boxes as results of the nuScenes detection task."""
    arguments = parse_arguments(ExportArguments, argv, "mirror annotate export", examples=_EXAMPLES)

    from mirror.annotation.review import export_results
    from mirror.dataset import open as open_dataset

    report = export_results(open_dataset(arguments.dataset), arguments.out, arguments.boxes)
    if arguments.json:
        print(json.dumps(asdict(report)))
    else:
        print(f"{report.path}: {report.boxes} boxes of layer {report.layer} in {report.samples} samples")
    return ExitCode.DONE
