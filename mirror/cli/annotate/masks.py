"""``mirror annotate masks``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode

_EXAMPLES: Final = ("mirror annotate masks demo/dataset --boxes synth@0.1.0",)


@dataclass(frozen=True)
class MaskArguments:
    """Write masks of road users for reconstruction and scoring: instance masks where given, else hulls of boxes.

    The masks of SOURCE@VERSION become the layer SOURCE-hulls@VERSION, of kind dynamic, which the static reconstruction
    and the protocols leave out. Parked vehicles are masked too; barriers and cones are not.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes."""
    version: Annotated[str | None, help_text(default="that of the boxes", metavar="NAME")] = None
    """Version of the layer of masks."""
    margin: float = 0.1
    """Growth of each box's length, width and height, as a share."""
    min_score: float = 0.3
    """Boxes with a lower score are left out; labels without a score count."""
    json: bool = False
    """Print JSON."""


def run(argv: Sequence[str]) -> int:
    """Write masks of road users."""
    arguments = parse_arguments(MaskArguments, argv, "mirror annotate masks", examples=_EXAMPLES)

    from mirror.annotation.masks import MaskOptions, mask_layer
    from mirror.dataset.writing import open_to_write
    from mirror.progress import progress_bar

    options = MaskOptions(arguments.margin, arguments.min_score)
    with progress_bar(quiet=arguments.json) as bar:
        report = mask_layer(
            open_to_write(arguments.dataset), arguments.boxes, options, version=arguments.version, progress=bar
        )
    if arguments.json:
        print(json.dumps({"dataset": str(arguments.dataset), **asdict(report)}))
        return ExitCode.DONE
    print(f"layer masks/{report.layer}: {len(report.written)} traversals written, {len(report.kept)} kept")
    if report.written:
        print(f"{report.images} masks; road users cover {report.share:.1%} of the pixels")
    return ExitCode.DONE
